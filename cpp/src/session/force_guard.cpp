#include "burrlab/session/force_guard.hpp"

#include <algorithm>
#include <cmath>

#include "burrlab/check.hpp"

namespace burrlab {
namespace {

/// A vector no longer than `most`, without overflow.
Vec3 shortened(const Vec3& v, double most) noexcept {
  const double largest = std::max({std::abs(v[0]), std::abs(v[1]), std::abs(v[2])});
  if (largest == 0.0) return v;
  const Vec3 direction = v / largest;
  const double length = direction.norm();
  return largest > most / length ? Vec3(direction * (most / length)) : v;
}

}  // namespace

ForceGuard::ForceGuard(double limit, double slew) : limit_(limit), slew_(slew) {
  require_positive("force limit", limit);
  require_positive("slew limit", slew);
}

Vec3 ForceGuard::apply(const Vec3& wanted, double dt) noexcept {
  const bool finite = std::isfinite(wanted[0]) && std::isfinite(wanted[1]) && std::isfinite(wanted[2]);
  const Vec3 target = finite ? shortened(wanted, limit_) : Vec3(Vec3::Zero());
  const double change = dt > 0.0 ? slew_ * dt : 0.0;
  last_ += shortened(target - last_, change);
  return last_;
}

}  // namespace burrlab
