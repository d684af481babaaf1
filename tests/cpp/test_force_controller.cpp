// The PID controller: terms, limits, anti-windup, filtered derivative, change of gains, reset.
#include "burrlab/force_controller.hpp"

#include "check.hpp"

using burrlab::ForceController;

namespace {

void check_terms() {
  ForceController pid(2.0, 10.0, 0.0, -10.0, 10.0, 5.0);
  CHECK_NEAR(pid.update(1.0, 0.5, 1.0), 1.005, 1e-15);
  CHECK_NEAR(pid.update(1.0, 0.5, 2.0), 1.015, 1e-15);
  CHECK_NEAR(pid.proportional_term(), 1.0, 0.0);
  CHECK_NEAR(pid.integral_term(), 0.015, 1e-15);
  CHECK(pid.derivative_term() == 0.0 && pid.output() == pid.proportional_term() + pid.integral_term());
}

void check_limits_and_windup() {
  ForceController pid(1.0, 100.0, 0.0, -2.0, 3.0, 0.0);
  for (int i = 0; i < 1000; ++i) CHECK(pid.update(1.0, -9.0, 10.0) <= 3.0);
  CHECK(pid.output() == 3.0);
  CHECK(pid.integral_term() <= 3.0);  // it stood still at the limit
  // Back within a tick or two of the error's change of sign, without unwinding a thousand ticks.
  pid.update(1.0, 6.0, 10.0);
  CHECK(pid.output() < 0.0);
  for (int i = 0; i < 1000; ++i) CHECK(pid.update(1.0, 9.0, 10.0) >= -2.0);
  CHECK(pid.output() == -2.0);
  // At a limit the integral can still move away from it.
  const double stuck = pid.integral_term();
  pid.update(1.0, 0.9, 10.0);
  CHECK(pid.integral_term() > stuck);
}

void check_derivative() {
  ForceController raw(0.0, 0.0, 0.5, -100.0, 100.0, 0.0);
  CHECK(raw.update(1.0, 2.0, 1.0) == 0.0);               // no past, no slope
  CHECK(raw.update(50.0, 2.0, 1.0) == 0.0);              // a step of the set-point gives no kick
  CHECK_NEAR(raw.update(50.0, 2.1, 1.0), -50.0, 1e-10);  // -kd 0.1 N/ms
  CHECK_NEAR(raw.update(50.0, 2.1, 1.0), 0.0, 1e-15);

  ForceController filtered(0.0, 0.0, 0.5, -100.0, 100.0, 4.0);
  double force = 0.0, last = 0.0;
  filtered.update(0.0, force, 1.0);
  for (int i = 1; i <= 60; ++i) {
    force += 0.1;
    const double output = filtered.update(0.0, force, 1.0);
    CHECK_NEAR(output, -50.0 * (1.0 - std::pow(0.8, i)), 1e-9);  // first order, dt/(dt + 4)
    CHECK(output < last);
    last = output;
  }
}

void check_gains_and_reset() {
  ForceController pid(1.0, 20.0, 0.1, -10.0, 10.0, 5.0);
  for (int i = 0; i < 100; ++i) pid.update(1.0, 0.9, 1.0);
  const double integral = pid.integral_term();
  pid.set_gains(1.0, 2.0, 0.1);
  CHECK(pid.integral_term() == integral);
  CHECK_NEAR(pid.update(0.9, 0.9, 1.0), integral, 1e-12);
  CHECK(pid.kp() == 1.0 && pid.ki() == 2.0 && pid.kd() == 0.1);

  pid.reset(0.5);
  CHECK(pid.integral_term() == 0.5 && pid.output() == 0.0 && pid.proportional_term() == 0.0);
  CHECK_NEAR(pid.update(1.0, 1.0, 1.0), 0.5, 1e-15);  // no slope over the reset
  pid.reset(1e3);
  CHECK(pid.integral_term() == 10.0);
}

void check_refusals() {
  const double nan = std::nan("");
  const auto make = [](double kp, double ki, double kd, double low, double high, double filter) {
    return ForceController(kp, ki, kd, low, high, filter).kp();
  };
  CHECK_THROWS(make(-1.0, 0.0, 0.0, -1.0, 1.0, 0.0), "kp must be zero or positive and finite, got -1");
  CHECK_THROWS(make(1.0, nan, 0.0, -1.0, 1.0, 0.0), "ki must be zero or positive and finite");
  CHECK_THROWS(make(1.0, 0.0, -2.0, -1.0, 1.0, 0.0), "kd must be zero or positive and finite, got -2");
  CHECK_THROWS(make(1.0, 0.0, 0.0, 1.0, 1.0, 0.0), "lower output limit must be below the upper one, got 1");
  CHECK_THROWS(make(1.0, 0.0, 0.0, nan, 1.0, 0.0), "lower output limit must be below the upper one");
  CHECK_THROWS(make(1.0, 0.0, 0.0, -1.0, 1.0, -1.0),
               "derivative_filter must be zero or positive and finite, got -1");

  ForceController pid(1.0, 1.0, 1.0, -10.0, 10.0, 0.0);
  pid.update(1.0, 0.5, 1.0);
  const double integral = pid.integral_term(), output = pid.output();
  CHECK_THROWS(pid.update(nan, 0.0, 1.0), "setpoint must be finite");
  CHECK_THROWS(pid.update(1.0, nan, 1.0), "force must be finite");
  CHECK_THROWS(pid.update(1.0, 0.0, 0.0), "dt must be positive and finite, got 0");
  CHECK_THROWS((pid.set_gains(1.0, -1.0, 0.0), 0), "ki must be zero or positive");
  CHECK_THROWS((pid.reset(nan), 0), "integral must be finite");
  CHECK(pid.integral_term() == integral && pid.output() == output);  // refused input changes nothing
}

}  // namespace

int main() {
  check_terms();
  check_limits_and_windup();
  check_derivative();
  check_gains_and_reset();
  check_refusals();
  return check::report();
}
