// The PID controller of the descent experiment, from force error to velocity command.
#pragma once

#include "require.hpp"

namespace burrlab {

/// velocity = kp e + integral of ki e dt - kd dF/dt, within limits; e is set-point minus measured force. The
/// derivative is that of the measured force, through a first-order filter. The integral term has the output's
/// unit, so gains may change without a jump. It stands still while it would push the output beyond a limit.
class ForceController {
 public:
  ForceController(double kp, double ki, double kd, double lower, double upper, double derivative_filter)
      : lower_(lower), upper_(upper), filter_(derivative_filter) {
    set_gains(kp, ki, kd);
    if (!(lower < upper)) refuse("lower output limit", "below the upper one", lower);
    require_not_negative("derivative_filter", filter_);
  }

  /// kp [mm/s/N], ki [mm/s/(N s)], kd [mm/s/(N/s)].
  void set_gains(double kp, double ki, double kd) {
    require_not_negative("kp", kp);
    require_not_negative("ki", ki);
    require_not_negative("kd", kd);
    kp_ = kp, ki_ = ki, kd_ = kd;
  }

  /// Velocity command [mm/s] from set-point and measured force [N], dt [ms] after the last update.
  double update(double setpoint, double force, double dt) {
    require_finite("setpoint", setpoint);
    require_finite("force", force);
    require_positive("dt", dt);
    const double seconds = 1e-3 * dt, error = setpoint - force;
    if (started_) {
      const double raw = (force - last_force_) / seconds;
      slope_ += (raw - slope_) * (dt / (dt + filter_));
    }
    last_force_ = force;
    started_ = true;
    const double proportional = kp_ * error, derivative = -kd_ * slope_;
    const double increment = ki_ * error * seconds;
    const double wanted = proportional + integral_ + increment + derivative;
    const bool pushes_out = (wanted > upper_ && increment > 0.0) || (wanted < lower_ && increment < 0.0);
    if (!pushes_out) integral_ += increment;
    return clamp(proportional + integral_ + derivative);
  }

  /// Resets the controller; the integral term starts at `integral` [mm/s].
  void reset(double integral) {
    require_finite("integral", integral);
    integral_ = clamp(integral);
    slope_ = last_force_ = 0.0;
    started_ = false;
  }

 private:
  double clamp(double v) const { return v < lower_ ? lower_ : v > upper_ ? upper_ : v; }

  double kp_ = 0.0, ki_ = 0.0, kd_ = 0.0;
  double lower_, upper_, filter_;
  double integral_ = 0.0, last_force_ = 0.0, slope_ = 0.0;
  bool started_ = false;
};

}  // namespace burrlab
