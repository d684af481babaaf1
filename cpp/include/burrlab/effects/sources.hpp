// Where parcels come from: bone that was removed, bleeding tissue that was opened, the nozzle.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "burrlab/effects/instruments.hpp"
#include "burrlab/effects/level_field.hpp"
#include "burrlab/effects/parcels.hpp"

namespace burrlab {

/// A burr in a frame.
struct BurrAt {
  Vec3 center = Vec3::Zero();  ///< [mm]
  double radius = 0.0;         ///< [mm]
};

/// Uniform numbers in [0, 1) that depend on (seed, frame, how many were drawn in it) alone.
class EffectDraws {
 public:
  EffectDraws(std::uint64_t seed, std::uint64_t frame) : seed_(seed), frame_(frame) {}
  double number();
  Vec3 in_ball();  ///< of radius 1

 private:
  std::uint64_t seed_, frame_;
  std::uint64_t block_ = 0;
  std::uint32_t left_[4] = {};
  int count_ = 0;
};

/// Parcels made in a frame, each with the part of the frame that it has been under way.
struct Emission {
  Vec3 place, velocity;
  Quanta mass{};
  double part = 0.0;  ///< of the frame
};

class Sources {
 public:
  Sources(const EffectParameters& parameters, const Vec3& down, const Vec3& spin, double quantum)
      : parameters_(&parameters), down_(down), spin_(spin), quantum_(quantum) {}

  /// Dust of what a brick lost, to the burr whose surface is nearest; opens wounds in tissue that bleeds.
  void remove(const LevelField& field, std::size_t brick, const BrickLoss& loss,
              const std::vector<BurrAt>& burrs, EffectDraws& draws, std::vector<Emission>& out);
  /// Blood of all wounds in `seconds`.
  void bleed(double seconds, EffectDraws& draws, std::vector<Emission>& out);
  /// Water of a nozzle in `seconds`, none while its burr is not there; `before`: the burrs at the last frame.
  void irrigate(const Nozzle& nozzle, double seconds, const std::vector<BurrAt>& burrs,
                const std::vector<BurrAt>& before, EffectDraws& draws, std::vector<Emission>& out);

  /// Levels removed so far, by tissue's number; [0] without tissues.
  const std::vector<std::int64_t>& removed() const { return removed_; }
  double bleeding() const;  ///< of all wounds now [mm^3/s]

 private:
  struct Wound {
    double rate = 0.0;   // [mm^3/s]
    double ready = 0.0;  // blood that has not come out yet, below a parcel's [mm^3]
    Vec3 place = Vec3::Zero();
  };
  Vec3 free_place(const LevelField& field, const Vec3& place, const BurrAt* burr) const;
  void split(std::int64_t quanta, double parcel, int substance, const Emission& like, EffectDraws& draws,
             std::vector<Emission>& out) const;

  const EffectParameters* parameters_;
  Vec3 down_, spin_;
  double quantum_;
  std::map<std::size_t, Wound> wounds_;  // by brick
  std::vector<std::int64_t> removed_;
  double water_ready_ = 0.0;  // [quanta], below one
};

}  // namespace burrlab
