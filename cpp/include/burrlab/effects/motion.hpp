// How a parcel moves: weight, drag in the air that a sucker draws, and bone that it slides on.
#pragma once

#include <optional>

#include "burrlab/effects/instruments.hpp"
#include "burrlab/effects/level_field.hpp"
#include "burrlab/effects/parcels.hpp"

namespace burrlab {

class Motion {
 public:
  Motion(const LevelField& field, const EffectParameters& parameters, const Vec3& down,
         const std::optional<Sucker>& sucker)
      : field_(&field), parameters_(&parameters), down_(down), sucker_(&sucker) {}

  /// What an interval of time does to a velocity, for dry and for wet parcels.
  struct Interval {
    double seconds = 0.0;
    double kept[2] = {1.0, 1.0};  ///< part of the velocity against the air that is left
    double way[2] = {0.0, 0.0};   ///< that a velocity against the air of 1 makes [s]
  };
  Interval interval(double seconds) const;

  /// Moves a parcel that lies in no solid voxel, and leaves it in none. Linear drag is solved exactly, so
  /// that in free air the size of the interval does not matter where the air is at rest.
  void advance(Parcels& parcels, std::size_t i, const Interval& interval) const;
  /// Whether a parcel that rests goes on doing so: its voxel is there, and the air of the sucker pulls less
  /// than friction holds.
  bool rests(const Parcels& parcels, std::size_t i) const;

 private:
  double friction(const Parcels& parcels, std::size_t i) const;

  const LevelField* field_;
  const EffectParameters* parameters_;
  Vec3 down_;
  const std::optional<Sucker>* sucker_;
};

}  // namespace burrlab
