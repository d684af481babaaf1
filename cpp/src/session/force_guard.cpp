#include "session/force_guard.hpp"

#include <algorithm>
#include <cmath>

#include "require.hpp"

namespace burrlab {

/// A vector no longer than `most`, without overflow.
static Vec3 shortened(const Vec3& v, double most) noexcept {
  const double largest = std::max({std::abs(v[0]), std::abs(v[1]), std::abs(v[2])});
  if (largest == 0.0) return v;
  const Vec3 direction = v / largest;
  const double length = direction.norm();
  return largest > most / length ? Vec3(direction * (most / length)) : v;
}

ForceGuard::ForceGuard(const GuardLimits& limits, double hold)
    : limits_(limits), bounded_(limits.ramp != 0.0 || !std::isinf(limits.continuous)) {
  require_positive("force limit", limits.force);
  require_positive("slew limit", limits.slew);
  if (!(limits.continuous > 0.0)) refuse("continuous limit", "positive", limits.continuous);
  require_positive("window", limits.window);
  if (!(limits.ramp >= 0.0 && limits.ramp < 1e6)) refuse("ramp", "from 0 and below 1e6 s", limits.ramp);
  const double least = 1e-3 * (hold + limits.force / limits.slew);
  reserve_ = least / limits.window;
  if (!std::isinf(limits.continuous) && !(reserve_ <= 1.0))
    refuse("window", "at least a stall plus force limit/slew limit, " + std::to_string(least) + " s",
           limits.window);
}

// m is the mean square over the window, c the continuous limit, F the size of what is sent, r the reserve:
//
//     m + r (F^2 - m) <= c^2        after every call,        r = (hold + limit/slew)/window <= 1.
//
// However long F acts, up to `hold`, m moves by at most r (F^2 - m): m <= c^2 until the next call. Then a
// force that keeps the rule can be reached. If F <= c, F itself keeps it. Else F - slew dt does: m has grown
// by at most dt F^2/window, and r F^2 shrinks by at least r slew dt F >= dt F^2/window, as r slew >=
// limit/window. So F never has to jump, and c may be sent for ever. The mean square of a force that is held,
// m' = (F^2 - m)/window, is taken from above: 1 - e^-x lies between x/(1 + x) and x. Over a stretch of length
// T the plain RMS is at most c sqrt(1 + window/T).
double ForceGuard::allowed(bool wanted, double dt) noexcept {
  double most = limits_.force;
  if (limits_.ramp > 0.0) {
    if (touched_) age_ += dt;
    touched_ |= wanted;
    most *= std::min(age_ / (1e3 * limits_.ramp), 1.0);
  }
  if (!std::isinf(limits_.continuous)) {
    const double square = last_.squaredNorm(), x = std::min(1e-3 * dt / limits_.window, 1.0);
    mean_ += (square > mean_ ? x : x / (1.0 + x)) * (square - mean_);
    const double left = std::max(limits_.continuous * limits_.continuous - mean_, 0.0);
    most = std::min(most, std::sqrt(mean_ + left / reserve_));
  }
  return most;
}

Vec3 ForceGuard::apply(const Vec3& wanted, double dt) noexcept {
  const bool finite = wanted.allFinite();
  const double passed = dt > 0.0 ? dt : 0.0;
  double change = limits_.slew * passed, most = limits_.force;
  if (bounded_) {
    most = allowed(finite && !wanted.isZero(0.0), passed);
    const double length = last_.norm();
    if (length > most) {  // first shorter, so that the rest of the way stays within
      last_ *= most / length;
      change = std::max(change - (length - most), 0.0);
    }
  }
  const Vec3 target = finite ? shortened(wanted, most) : Vec3(Vec3::Zero());
  last_ += shortened(target - last_, change);
  return last_;
}

void ForceGuard::reset() noexcept {
  last_.setZero();
  touched_ = false;
  age_ = 0.0;
}

}  // namespace burrlab
