// What the secondary effects are made of: rates, sizes, friction. The paper gives no numbers, so all but
// gravity are assumed (docs/effects.md).
#pragma once

#include <vector>

#include "burrlab/types.hpp"

namespace burrlab {

struct EffectParameters {
  double gravity = 9806.65;  ///< [mm/s^2]
  double solid_level = 128;  ///< voxels from this level on stop a parcel
  double margin = 10.0;      ///< around the volume; what goes further is drained [mm]
  double restitution = 0.1;  ///< part of the normal velocity that comes back from bone
  double rest_speed = 2.0;   ///< slower than this on bone a parcel rests [mm/s]

  double dust_parcel = 0.002;    ///< solid bone in a new parcel [mm^3]
  double dust_bulking = 2.5;     ///< volume seen over that of the solid bone
  double dust_speed = 1000.0;    ///< with which it leaves the burr, along its surface [mm/s]
  double dust_spread = 0.3;      ///< scatter of that velocity, part of it
  double dust_drag_time = 0.02;  ///< in which air takes a dry parcel's speed [s]
  double dust_friction = 0.6;    ///< of dry dust on bone

  double blood_rate = 0.5;        ///< blood of a bleeding tissue over the volume opened [mm^3/s per mm^3]
  double blood_decay = 20.0;      ///< in which that rate falls to 1/e [s]
  double blood_parcel = 0.05;     ///< [mm^3]
  double water_parcel = 0.3;      ///< [mm^3]
  double water_spread = 0.1;      ///< scatter of the jet's velocity, part of it
  double liquid_drag_time = 0.1;  ///< in which air takes a wet parcel's speed [s]
  double liquid_friction = 0.05;  ///< of a wet parcel without dust on bone
  double paste_friction = 0.9;    ///< of a wet parcel that is all dust on bone

  double wetting_distance = 0.5;  ///< side of the cells in which dust meets liquid [mm]
  double paste_saturation = 1.0;  ///< dust that a liquid takes up over its own volume
  double merge_distance = 0.5;    ///< side of the cells in which parcels merge first [mm]

  double dust_opacity = 0.8;   ///< part of the light that a parcel of it takes away
  double blood_opacity = 0.8;  ///< the same
  double water_opacity = 0.1;  ///< the same

  double sub_steps = 4;         ///< of a frame, at most
  double most_parcels = 20000;  ///< more than these merge

  /// Throws unless each lies in its range (`effect_parameter_table`).
  void check() const;
};

/// One row of the table that checks, bindings and documents read.
struct EffectParameterRow {
  const char* name;
  const char* unit;  ///< "" for a plain number
  double EffectParameters::* value;
  double least, most;  ///< inclusive
  bool whole;          ///< only whole numbers
  bool assumed;        ///< not known from any source of ours
};

const std::vector<EffectParameterRow>& effect_parameter_table();

}  // namespace burrlab
