#include "effects/effect_parameters.hpp"

#include <cmath>
#include <sstream>

#include "require.hpp"

namespace burrlab {

const std::vector<EffectParameterRow>& effect_parameter_table() {
  using P = EffectParameters;
  static const std::vector<EffectParameterRow> table = {
      {"gravity", "mm/s^2", &P::gravity, 0.0, 1e6, false, false},
      {"solid_level", "level", &P::solid_level, 1.0, 255.0, true, true},
      {"margin", "mm", &P::margin, 0.0, 1000.0, false, true},
      {"restitution", "", &P::restitution, 0.0, 1.0, false, true},
      {"rest_speed", "mm/s", &P::rest_speed, 0.0, 1000.0, false, true},
      {"dust_parcel", "mm^3", &P::dust_parcel, 1e-9, 1000.0, false, true},
      {"dust_bulking", "", &P::dust_bulking, 1.0, 100.0, false, true},
      {"dust_speed", "mm/s", &P::dust_speed, 0.0, 1e5, false, true},
      {"dust_spread", "", &P::dust_spread, 0.0, 10.0, false, true},
      {"dust_drag_time", "s", &P::dust_drag_time, 1e-4, 1000.0, false, true},
      {"dust_friction", "", &P::dust_friction, 0.0, 10.0, false, true},
      {"blood_rate", "mm^3/s per mm^3", &P::blood_rate, 0.0, 1e4, false, true},
      {"blood_decay", "s", &P::blood_decay, 1e-2, 1e5, false, true},
      {"blood_parcel", "mm^3", &P::blood_parcel, 1e-9, 1000.0, false, true},
      {"water_parcel", "mm^3", &P::water_parcel, 1e-9, 1000.0, false, true},
      {"water_spread", "", &P::water_spread, 0.0, 10.0, false, true},
      {"liquid_drag_time", "s", &P::liquid_drag_time, 1e-4, 1000.0, false, true},
      {"liquid_friction", "", &P::liquid_friction, 0.0, 10.0, false, true},
      {"paste_friction", "", &P::paste_friction, 0.0, 10.0, false, true},
      {"wetting_distance", "mm", &P::wetting_distance, 1e-3, 100.0, false, true},
      {"paste_saturation", "", &P::paste_saturation, 0.0, 100.0, false, true},
      {"merge_distance", "mm", &P::merge_distance, 1e-3, 100.0, false, true},
      {"dust_opacity", "", &P::dust_opacity, 0.0, 1.0, false, true},
      {"blood_opacity", "", &P::blood_opacity, 0.0, 1.0, false, true},
      {"water_opacity", "", &P::water_opacity, 0.0, 1.0, false, true},
      {"sub_steps", "", &P::sub_steps, 1.0, 64.0, true, true},
      {"most_parcels", "", &P::most_parcels, 16.0, 1e6, true, true},
  };
  return table;
}

void EffectParameters::check() const {
  for (const EffectParameterRow& row : effect_parameter_table()) {
    const double value = this->*row.value;
    if (value >= row.least && value <= row.most && (!row.whole || value == std::floor(value))) continue;
    std::ostringstream rule;
    rule << (row.whole ? "a whole number " : "") << "from " << row.least << " to " << row.most;
    if (*row.unit) rule << " " << row.unit;
    refuse(row.name, rule.str(), value);
  }
}

}  // namespace burrlab
