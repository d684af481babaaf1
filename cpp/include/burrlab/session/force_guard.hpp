// The last thing that a force passes on its way to a hand: it is kept small, and it changes gently.
#pragma once

#include "burrlab/types.hpp"

namespace burrlab {

/// Scales a force to the limit, keeping its direction, then limits its change. The defaults are ours: above
/// what burring asks for (2 N and a few N/mm at 100 mm/s), below what a desktop device gives for long.
class ForceGuard {
 public:
  static constexpr double default_limit = 8.0;  ///< [N]
  static constexpr double default_slew = 1.0;   ///< [N/ms]

  explicit ForceGuard(double limit = default_limit, double slew = default_slew);  ///< [N], [N/ms]

  /// The force to send [N], dt [ms] after the last one. Finite whatever comes in: what is not finite counts
  /// as zero, and the change to it is limited like any other. A dt that is not positive allows no change.
  Vec3 apply(const Vec3& wanted, double dt) noexcept;
  void reset() noexcept { last_.setZero(); }  ///< as if the last force was zero

  double limit() const { return limit_; }  ///< [N]
  double slew() const { return slew_; }    ///< [N/ms]

 private:
  double limit_, slew_;
  Vec3 last_ = Vec3::Zero();
};

}  // namespace burrlab
