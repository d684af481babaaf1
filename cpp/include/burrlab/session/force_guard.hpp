// The last limit on a force before it is sent to a hand.
#pragma once

#include <limits>

#include "burrlab/types.hpp"

namespace burrlab {

/// What a guard keeps to. The defaults are ours: above what burring needs (2 N and a few N/mm at 100 mm/s),
/// below what a desktop device gives for long; no continuous limit, no ramp.
struct GuardLimits {
  double force = 8.0;                                           ///< size of a force [N]
  double slew = 1.0;                                            ///< its change [N/ms]
  double continuous = std::numeric_limits<double>::infinity();  ///< its RMS over the window [N]
  double window = 10.0;  ///< time constant of the exponential window [s]; ours
  double ramp = 0.0;     ///< time over which the allowed force grows from zero after the first contact [s]
};

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
