// The last limit on a force before it is sent to a hand.
#pragma once

#include "burrlab/types.hpp"

namespace burrlab {

/// Limits the size of a force, keeping its direction, then its change. The defaults are ours: above what
/// burring needs (2 N and a few N/mm at 100 mm/s), below what a desktop device gives for long.
class ForceGuard {
 public:
  static constexpr double default_limit = 8.0;  ///< [N]
  static constexpr double default_slew = 1.0;   ///< [N/ms]

  explicit ForceGuard(double limit = default_limit, double slew = default_slew);  ///< [N], [N/ms]

  /// The force to send [N], dt [ms] after the last one. Always finite: an input that is not counts as
  /// zero, and the change to zero is limited too. A dt that is not positive allows no change.
  Vec3 apply(const Vec3& wanted, double dt) noexcept;
  void reset() noexcept { last_.setZero(); }  ///< as if the last force was zero

  double limit() const { return limit_; }  ///< [N]
  double slew() const { return slew_; }    ///< [N/ms]

 private:
  double limit_, slew_;
  Vec3 last_ = Vec3::Zero();
};

}  // namespace burrlab
