// The motion of a parcel: weight, drag in the air that a sucker moves, and sliding on bone.
#pragma once

#include <optional>

#include "effects/instruments.hpp"
#include "effects/level_field.hpp"
#include "effects/parcels.hpp"

namespace burrlab {

class Motion {
 public:
  Motion(const LevelField& field, const EffectParameters& parameters, const Vec3& down,
         const std::optional<Sucker>& sucker)
      : field_(&field), parameters_(&parameters), down_(down), sucker_(&sucker) {}

  /// What drag does to a velocity in an interval, for dry and for wet parcels.
  struct Interval {
    double seconds = 0.0;
    double kept[2] = {1.0, 1.0};  ///< part of the velocity against the air that remains
    double way[2] = {0.0, 0.0};   ///< way per velocity against the air [s]
  };
  Interval interval(double seconds) const;

  /// Moves a parcel from one free place to another. Linear drag is solved exactly, so in still air without
  /// bone the length of the interval does not matter.
  void advance(Parcels& parcels, std::size_t i, const Interval& interval) const;
  /// Whether a parcel stays at rest: the voxel under it is solid, and friction holds it against the air.
  bool rests(const Parcels& parcels, std::size_t i) const;

 private:
  double friction(const Parcels& parcels, std::size_t i) const;

  const LevelField* field_;
  const EffectParameters* parameters_;
  Vec3 down_;
  const std::optional<Sucker>* sucker_;
};

}  // namespace burrlab
