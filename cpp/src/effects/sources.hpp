// Sources of parcels: removed bone, opened tissue that bleeds, the nozzle.
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "effects/instruments.hpp"
#include "effects/level_field.hpp"
#include "effects/parcels.hpp"

namespace burrlab {

/// A burr in a frame.
struct BurrAt {
  Vec3 center = Vec3::Zero();  ///< [mm]
  double radius = 0.0;         ///< [mm]
};

/// Uniform numbers in [0, 1), a function of seed, frame and the count of draws in the frame.
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

/// A parcel made in a frame.
struct Emission {
  Vec3 place, velocity;
  Quanta mass{};
  double part = 0.0;  ///< of the frame, since it was made
};

class Sources {
 public:
  Sources(const EffectParameters& parameters, const Vec3& down, const Vec3& spin, double quantum)
      : parameters_(&parameters), down_(down), spin_(spin), quantum_(quantum) {}

  /// Makes dust of what a brick lost, at the burr with the nearest surface; opens wounds in bleeding tissue.
  void remove(const LevelField& field, std::size_t brick, const BrickLoss& loss,
              const std::vector<BurrAt>& burrs, EffectDraws& draws, std::vector<Emission>& out);
  /// Makes the blood of all wounds in `seconds`.
  void bleed(double seconds, EffectDraws& draws, std::vector<Emission>& out);
  /// Makes the water of a nozzle in `seconds`; none without its burr. `before`: the burrs of the last frame.
  void irrigate(const Nozzle& nozzle, double seconds, const std::vector<BurrAt>& burrs,
                const std::vector<BurrAt>& before, EffectDraws& draws, std::vector<Emission>& out);

  /// Levels removed so far, by tissue number; one entry without tissues.
  const std::vector<std::int64_t>& removed() const { return removed_; }
  double bleeding() const;  ///< of all wounds [mm^3/s]

 private:
  struct Wound {
    double rate = 0.0;   // [mm^3/s]
    double ready = 0.0;  // blood to come out, less than a parcel [mm^3]
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
  double water_ready_ = 0.0;  // [quanta], less than one
};

}  // namespace burrlab
