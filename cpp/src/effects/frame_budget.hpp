// The time budget of a frame of effects. The cost of past frames sets how fine the next is.
#pragma once

#include <cstddef>
#include <cstdint>

namespace burrlab {

/// All that the clock decides in a frame. A frame made again with its decision is the same.
struct FrameDecision {
  std::int64_t merge_to = 0;  ///< most parcels before they are moved
  std::int32_t sub_steps = 1;
  std::int32_t done = 1;  ///< sub-steps made before the rest was made in one
};

/// Counts of what was left out.
struct FrameCounts {
  std::int64_t frames = 0, over_budget = 0;
  std::int64_t coarse = 0;   ///< frames planned with fewer sub-steps than the parameters ask for
  std::int64_t cut = 0;      ///< frames whose last sub-steps were made as one
  std::int64_t crowded = 0;  ///< frames that merged parcels to save time
  std::int64_t skipped = 0;  ///< frames skipped because one came late
  std::int64_t merged = 0;   ///< parcels merged into others, at the limit or to save time
  std::int64_t least_sub_steps = 0, most_sub_steps = 0, sub_steps = 0;  ///< `sub_steps`: of all frames
  std::int64_t most_parcels = 0;                                        ///< at the end of a frame
};

class FrameBudget {
 public:
  static constexpr std::int64_t least_parcels = 64;  ///< the fewest it asks for

  explicit FrameBudget(double seconds) : nanoseconds_(1e9 * seconds) {}

  double nanoseconds() const { return nanoseconds_; }
  /// The finest frame that should take half of the budget. If a single sub-step should take over 70 %,
  /// parcels merge until it takes half.
  FrameDecision plan(std::size_t moving, std::size_t parcels, int sub_steps, std::int64_t limit) const;
  /// Whether, after this time [ns], the rest of the frame should be made in one step.
  bool late(double elapsed) const { return elapsed > 0.6 * nanoseconds_; }
  /// Learns from a frame: the time [ns] of its single movements, and of all else for its parcels.
  void learn(double moves, double moving_time, double parcels, double other_time);

 private:
  double nanoseconds_;
  double of_move_ = 400.0, of_parcel_ = 200.0;  // [ns]; first guesses, on the safe side
};

}  // namespace burrlab
