// Parameters of the secondary effects. All but gravity are assumed: the paper has none (docs/effects.md).
#pragma once

#include <vector>

#include "burrlab/types.hpp"

namespace burrlab {

// clang-format off
/// Name, default, unit ("" for a plain number), least and most (inclusive), whole numbers only, not from a source.
#define BURRLAB_EFFECT_PARAMETERS(parameter) \
  parameter(gravity, 9806.65, "mm/s^2", 0.0, 1e6, false, false) \
  parameter(solid_level, 128, "level", 1.0, 255.0, true, true) /* voxels of at least this level stop a parcel */ \
  parameter(margin, 10.0, "mm", 0.0, 1000.0, false, true) /* around the volume; parcels beyond it are drained */ \
  parameter(restitution, 0.1, "", 0.0, 1.0, false, true) /* part of the normal velocity that bone reflects */ \
  parameter(rest_speed, 2.0, "mm/s", 0.0, 1000.0, false, true) /* a parcel slower than this on bone comes to rest */ \
  parameter(dust_parcel, 0.002, "mm^3", 1e-9, 1000.0, false, true) /* solid bone in a new parcel */ \
  parameter(dust_bulking, 2.5, "", 1.0, 100.0, false, true) /* visible volume over the volume of the solid bone */ \
  parameter(dust_speed, 1000.0, "mm/s", 0.0, 1e5, false, true) /* of dust leaving the burr, along its surface */ \
  parameter(dust_spread, 0.3, "", 0.0, 10.0, false, true) /* scatter of that velocity, relative */ \
  parameter(dust_drag_time, 0.02, "s", 1e-4, 1000.0, false, true) /* time constant of the air's drag on dry parcels */ \
  parameter(dust_friction, 0.6, "", 0.0, 10.0, false, true) /* of dry dust on bone */ \
  parameter(blood_rate, 0.5, "mm^3/s per mm^3", 0.0, 1e4, false, true) /* of bleeding, per volume of tissue opened */ \
  parameter(blood_decay, 20.0, "s", 1e-2, 1e5, false, true) /* time in which that rate falls to 1/e */ \
  parameter(blood_parcel, 0.05, "mm^3", 1e-9, 1000.0, false, true) \
  parameter(water_parcel, 0.3, "mm^3", 1e-9, 1000.0, false, true) \
  parameter(water_spread, 0.1, "", 0.0, 10.0, false, true) /* scatter of the jet's velocity, relative */ \
  parameter(liquid_drag_time, 0.1, "s", 1e-4, 1000.0, false, true) /* time constant of the air's drag on wet ones */ \
  parameter(liquid_friction, 0.05, "", 0.0, 10.0, false, true) /* of a wet parcel without dust on bone */ \
  parameter(paste_friction, 0.9, "", 0.0, 10.0, false, true) /* of a wet parcel that is all dust on bone */ \
  parameter(wetting_distance, 0.5, "mm", 1e-3, 100.0, false, true) /* edge of the cells in which dust meets liquid */ \
  parameter(paste_saturation, 1.0, "", 0.0, 100.0, false, true) /* dust a liquid can take up, over its own volume */ \
  parameter(merge_distance, 0.5, "mm", 1e-3, 100.0, false, true) /* edge of the first cells in which parcels merge */ \
  parameter(dust_opacity, 0.8, "", 0.0, 1.0, false, true) /* part of the light that a parcel absorbs */ \
  parameter(blood_opacity, 0.8, "", 0.0, 1.0, false, true) /* as for dust */ \
  parameter(water_opacity, 0.1, "", 0.0, 1.0, false, true) /* as for dust */ \
  parameter(sub_steps, 4, "", 1.0, 64.0, true, true) /* of a frame, at most */ \
  parameter(most_parcels, 20000, "", 16.0, 1e6, true, true) /* above this parcels merge */
// clang-format on

struct EffectParameters {
#define BURRLAB_FIELD(name, usual, ...) double name = usual;
  BURRLAB_EFFECT_PARAMETERS(BURRLAB_FIELD)
#undef BURRLAB_FIELD

  /// Throws unless each is in its range (`effect_parameter_table`).
  void check() const;
};

/// One row of the table of parameters that checks, bindings and documents use.
struct EffectParameterRow {
  const char* name;
  const char* unit;  ///< "" for a plain number
  double EffectParameters::* value;
  double least, most;  ///< inclusive
  bool whole;          ///< whole numbers only
  bool assumed;        ///< not from a source
};

const std::vector<EffectParameterRow>& effect_parameter_table();

}  // namespace burrlab
