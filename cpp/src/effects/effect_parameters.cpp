#include "effects/effect_parameters.hpp"

#include <cmath>
#include <sstream>

#include "require.hpp"

namespace burrlab {

const std::vector<EffectParameterRow>& effect_parameter_table() {
#define BURRLAB_ROW(name, usual, unit, least, most, whole, assumed) \
  {#name, unit, &EffectParameters::name, least, most, whole, assumed},
  static const std::vector<EffectParameterRow> table = {BURRLAB_EFFECT_PARAMETERS(BURRLAB_ROW)};
#undef BURRLAB_ROW
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
