// Argument checks: one sentence with the parameter, the rule and the value received.
#pragma once

#include <cmath>
#include <sstream>
#include <string>

#include "burrlab/types.hpp"

namespace burrlab {

[[noreturn]] inline void refuse(const std::string& name, const std::string& rule, double value) {
  std::ostringstream text;
  text.imbue(std::locale::classic());
  text.precision(12);
  text << name << " must be " << rule << ", got " << value;
  throw InvalidArgument(text.str());
}

inline void require_finite(const std::string& name, double value) {
  if (!std::isfinite(value)) refuse(name, "finite", value);
}

inline void require_finite(const std::string& name, const Vec3& v) {
  for (const double x : v) require_finite(name, x);
}

inline void require_positive(const std::string& name, double value) {
  if (!(std::isfinite(value) && value > 0.0)) refuse(name, "positive and finite", value);
}

inline void require_not_negative(const std::string& name, double value) {
  if (!(std::isfinite(value) && value >= 0.0)) refuse(name, "zero or positive and finite", value);
}

}  // namespace burrlab
