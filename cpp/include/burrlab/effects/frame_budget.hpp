// What a frame of effects may cost: how fine it is made, by what frames before it cost.
#pragma once

#include <cstddef>
#include <cstdint>

namespace burrlab {

/// All that the clock decides in a frame; given again, the frame comes out the same.
struct FrameDecision {
  std::int64_t merge_to = 0;  ///< parcels at most before it moves them
  std::int32_t sub_steps = 1;
  std::int32_t done = 1;  ///< after so many sub-steps what was left of the frame was made in one
};

/// Counts of what was given up.
struct FrameCounts {
  std::int64_t frames = 0, over_budget = 0;
  std::int64_t coarse = 0;   ///< frames planned with fewer sub-steps than the parameters ask for
  std::int64_t cut = 0;      ///< frames whose last sub-steps became one
  std::int64_t crowded = 0;  ///< frames that merged parcels to save time
  std::int64_t skipped = 0;  ///< frames that one that came late stood for besides itself
  std::int64_t merged = 0;   ///< parcels that went into others, at the limit or to save time
  std::int64_t least_sub_steps = 0, most_sub_steps = 0, sub_steps = 0;  ///< the last: of all frames
  std::int64_t most_parcels = 0;                                        ///< at the end of a frame
};

class FrameBudget {
 public:
  static constexpr std::int64_t least_parcels = 64;  ///< fewer it never asks for

  explicit FrameBudget(double seconds) : nanoseconds_(1e9 * seconds) {}

  double nanoseconds() const { return nanoseconds_; }
  /// The finest frame that is expected to take half of the budget; parcels merge, down to that half, only
  /// where a single sub-step is expected to take 70 %.
  FrameDecision plan(std::size_t moving, std::size_t parcels, int sub_steps, std::int64_t limit) const;
  /// Whether after so long [ns] what is left should be made in one.
  bool late(double elapsed) const { return elapsed > 0.6 * nanoseconds_; }
  /// What a frame took: [ns] for so many single movements, and for all else of so many parcels.
  void learn(double moves, double moving_time, double parcels, double other_time);

 private:
  double nanoseconds_;
  double of_move_ = 400.0, of_parcel_ = 200.0;  // [ns]; a first guess, on the safe side
};

}  // namespace burrlab
