// Parameters of the secondary effects. All but gravity are assumed: the paper has none (docs/effects.md).
#pragma once

#include <vector>

#include "burrlab/types.hpp"

namespace burrlab {

struct EffectParameters {
  double gravity = 9806.65;  ///< [mm/s^2]
  double solid_level = 128;  ///< voxels of at least this level stop a parcel
  double margin = 10.0;      ///< around the volume; parcels beyond it are drained [mm]
  double restitution = 0.1;  ///< part of the normal velocity that bone reflects
  double rest_speed = 2.0;   ///< a parcel slower than this on bone comes to rest [mm/s]

  double dust_parcel = 0.002;    ///< solid bone in a new parcel [mm^3]
  double dust_bulking = 2.5;     ///< visible volume over the volume of the solid bone
  double dust_speed = 1000.0;    ///< of dust leaving the burr, along its surface [mm/s]
  double dust_spread = 0.3;      ///< scatter of that velocity, relative
  double dust_drag_time = 0.02;  ///< time constant of the air's drag on a dry parcel [s]
  double dust_friction = 0.6;    ///< of dry dust on bone

  double blood_rate = 0.5;        ///< of bleeding, per volume of tissue opened [mm^3/s per mm^3]
  double blood_decay = 20.0;      ///< time in which that rate falls to 1/e [s]
  double blood_parcel = 0.05;     ///< [mm^3]
  double water_parcel = 0.3;      ///< [mm^3]
  double water_spread = 0.1;      ///< scatter of the jet's velocity, relative
  double liquid_drag_time = 0.1;  ///< time constant of the air's drag on a wet parcel [s]
  double liquid_friction = 0.05;  ///< of a wet parcel without dust on bone
  double paste_friction = 0.9;    ///< of a wet parcel that is all dust on bone

  double wetting_distance = 0.5;  ///< edge of the cells in which dust meets liquid [mm]
  double paste_saturation = 1.0;  ///< dust a liquid can take up, over its own volume
  double merge_distance = 0.5;    ///< edge of the first cells in which parcels merge [mm]

  double dust_opacity = 0.8;   ///< part of the light that a parcel absorbs
  double blood_opacity = 0.8;  ///< as for dust
  double water_opacity = 0.1;  ///< as for dust

  double sub_steps = 4;         ///< of a frame, at most
  double most_parcels = 20000;  ///< above this parcels merge

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
