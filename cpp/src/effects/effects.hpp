// Dust, blood, water and a sucker beside a bone that loses mass, frame by frame.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "burrlab/session/histogram.hpp"
#include "effects/frame_budget.hpp"
#include "effects/hidden_fraction.hpp"
#include "effects/motion.hpp"
#include "effects/sources.hpp"

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
  Vec3 spin = Vec3(0.0, 0.0, 1.0);   ///< axis the burrs turn about
  std::optional<double> budget;      ///< of a frame [s]; without it the clock decides nothing
};

/// The same frames with the same decisions give the same parcels. For one thread at a time.
class Effects {
 public:
  /// Copies the bone's levels. Bone removed before makes no dust.
  Effects(const VoxelBone& bone, const EffectsSetup& setup);
  ~Effects();

  void set_nozzle(const std::optional<Nozzle>& nozzle);
  void set_sucker(const std::optional<Sucker>& sucker);
  const std::optional<Nozzle>& nozzle() const { return nozzle_; }
  const std::optional<Sucker>& sucker() const { return sucker_; }

  /// One frame of `seconds`. `decision`: that of the same frame in another run. `started`: the beginning of
  /// the frame on the steady clock [ns], if work came before this call; 0: now.
  FrameDecision step(double seconds, const BrickLevels& changes, const std::vector<BurrAt>& burrs,
                     const FrameDecision* decision = nullptr, std::int64_t started = 0);
  /// Counts the last frame: the time it took, and the frames skipped before it.
  void count_frame(double wall_microseconds, double cpu_microseconds, int skipped = 0);

  void view(std::vector<ParcelView>& out) const;  ///< all parcels, into existing memory
  std::array<SubstanceBalance, substances> balance() const;
  double quantum() const { return field_.quantum(); }  ///< [mm^3]
  double hidden(const Camera& camera, const BurrAt& burr) const {
    return hidden_fraction(parcels_, quantum(), setup_.parameters, camera, burr);
  }
  const Sources& sources() const { return sources_; }
  const EffectsSetup& setup() const { return setup_; }
  const FrameCounts& counts() const { return counts_; }
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
  double room_ = 0.0;  // of the sucker in this frame [quanta]
  std::optional<FrameBudget> budget_;
  double moves_ = 0.0, moving_time_ = 0.0;  // single movements of the last frame, and their time [ns]
  FrameCounts counts_;
  Histogram wall_time_, cpu_time_;
  std::vector<Emission> emissions_;  // kept for its memory, as are the next two
  std::vector<std::uint32_t> moving_;
  std::unique_ptr<CellTable> cells_;
};

}  // namespace burrlab
