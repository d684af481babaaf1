// Dust, blood, water and a sucker, frame by frame, beside a bone that loses mass.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "burrlab/effects/frame_budget.hpp"
#include "burrlab/effects/hidden_fraction.hpp"
#include "burrlab/effects/motion.hpp"
#include "burrlab/effects/sources.hpp"
#include "burrlab/session/histogram.hpp"

namespace burrlab {

class CellTable;

/// Bricks that changed since the last frame, with 512 levels each.
struct BrickLevels {
  const std::uint32_t* bricks = nullptr;
  const std::uint8_t* density = nullptr;
  std::size_t count = 0;
};

struct EffectsSetup {
  EffectParameters parameters{};
  std::uint64_t seed = 0;
  Vec3 down = Vec3(0.0, 0.0, -1.0);  ///< of gravity
  Vec3 spin = Vec3(0.0, 0.0, 1.0);   ///< axis that burrs turn about
  std::optional<double> budget;      ///< of a frame [s]; without it nothing depends on the clock
};

/// The same frames, with the same decisions of the clock, give the same parcels. One thread at a time.
class Effects {
 public:
  /// Copies the bone's levels; bone that is gone then made no dust.
  Effects(const VoxelBone& bone, const EffectsSetup& setup);
  ~Effects();
  Effects(const Effects&) = delete;
  Effects& operator=(const Effects&) = delete;

  void set_nozzle(const std::optional<Nozzle>& nozzle);
  void set_sucker(const std::optional<Sucker>& sucker);
  const std::optional<Nozzle>& nozzle() const { return nozzle_; }
  const std::optional<Sucker>& sucker() const { return sucker_; }

  /// One frame of `seconds`. `decision`: that of the same frame of another run. `started`: when the frame
  /// began on the steady clock [ns], where work came before it; 0: now.
  FrameDecision step(double seconds, const BrickLevels& changes, const std::vector<BurrAt>& burrs,
                     const FrameDecision* decision = nullptr, std::int64_t started = 0);
  /// Notes what the last frame took in all, and how many it stood for besides itself.
  void count_frame(double wall_microseconds, double cpu_microseconds, int skipped = 0);

  const Parcels& parcels() const { return parcels_; }
  std::vector<ParcelView> view() const;
  void view(std::vector<ParcelView>& out) const;  ///< the same, in memory that is there
  std::array<SubstanceBalance, substances> balance() const;
  double quantum() const { return field_.quantum(); }  ///< [mm^3]
  double hidden(const Camera& camera, const BurrAt& burr) const {
    return hidden_fraction(parcels_, quantum(), setup_.parameters, camera, burr);
  }
  std::size_t embedded() const;  ///< parcels in solid voxels: none
  const LevelField& field() const { return field_; }
  const Sources& sources() const { return sources_; }
  std::int64_t refilled() const { return refilled_; }  ///< levels that rose, as when a replay goes back
  const EffectsSetup& setup() const { return setup_; }
  const FrameCounts& counts() const { return counts_; }
  const std::vector<FrameDecision>& decisions() const { return decisions_; }
  const Histogram& wall_time() const { return wall_time_; }
  const Histogram& cpu_time() const { return cpu_time_; }

 private:
  void take_levels(const BrickLevels& changes, const std::vector<BurrAt>& burrs, EffectDraws& draws);
  Vec3 lifted(Vec3 place) const;
  void move(double seconds, FrameDecision& decision, bool given, std::int64_t started);
  void move_all(const Motion::Interval& interval);
  void settle(std::size_t i, const Vec3& before);
  void emit(double seconds);
  void wet();
  void merge_to(std::int64_t most);

  EffectsSetup setup_;
  LevelField field_;
  std::optional<Nozzle> nozzle_;
  std::optional<Sucker> sucker_;
  Motion motion_;
  Sources sources_;
  Parcels parcels_;
  std::vector<BurrAt> burrs_;  // of the last frame
  std::uint64_t frame_ = 0;
  Quanta made_{}, sucked_{}, drained_{};
  std::int64_t refilled_ = 0;
  double room_ = 0.0;  // that the sucker has left in this frame [quanta]
  std::optional<FrameBudget> budget_;
  double moves_ = 0.0, moving_time_ = 0.0;  // single movements of the last frame, and what they took [ns]
  FrameCounts counts_;
  std::vector<FrameDecision> decisions_;
  Histogram wall_time_, cpu_time_;
  std::vector<Emission> emissions_;  // kept for its memory, as the next two
  std::vector<std::uint32_t> moving_;
  std::unique_ptr<CellTable> cells_;
};

}  // namespace burrlab
