// The last limit on a force before it is sent to a hand.
#pragma once

#include "burrlab/session/loop_settings.hpp"

namespace burrlab {

/// Limits the size of a force, keeping its direction, then its change.
class ForceGuard {
 public:
  /// `hold`: longest time for which a force may act before the next one is asked for [ms].
  explicit ForceGuard(const GuardLimits& limits, double hold = 100.0);
  ForceGuard(double force, double slew) : ForceGuard(GuardLimits{force, slew}) {}  ///< [N], [N/ms]

  /// The force to send [N], dt [ms] after the last one. Always finite: an input that is not counts as
  /// zero, and the change to zero is limited too. A dt that is not positive allows no change.
  Vec3 apply(const Vec3& wanted, double dt) noexcept;
  /// As if the last force was zero: the ramp begins anew, what the continuous limit has seen stays.
  void reset() noexcept;

  double mean_square() const { return mean_; }  ///< of what was sent, over the window [N^2]

 private:
  double allowed(bool wanted, double dt) noexcept;

  GuardLimits limits_;
  bool bounded_, touched_ = false;
  double reserve_, age_ = 0.0, mean_ = 0.0;  // part of the window [1], time since the first contact [ms]
  Vec3 last_ = Vec3::Zero();
};

}  // namespace burrlab
