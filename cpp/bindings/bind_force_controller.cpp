#include "bindings.hpp"
#include "force_controller.hpp"

void bind_force_controller(py::module_& m) {
  Class<ForceController>(m, "ForceController",
                         R"(PID controller on the force error that commands the velocity of a rig.

velocity = kp e + integral of ki e dt - kd dF/dt, within the output limits; e is set-point minus measured
force. The derivative is that of the measured force, through a first-order filter. The integral stands still
while it would push the output beyond a limit. A virtual and a real rig use the same object.

Parameters
----------
kp : float
    [mm/s/N]
ki : float
    [mm/s/(N s)]
kd : float
    [mm/s/(N/s)]
output_limits : (float, float)
    Velocity [mm/s].
derivative_filter : float
    Time constant [ms].

Raises
------
ValueError
    If a gain is negative or not finite, or the limits are not in order.

Examples
--------
>>> import burrlab
>>> pid = burrlab.ForceController(kp=2.0, ki=10.0, output_limits=(-10, 10))
>>> round(pid.update(setpoint=1.0, force=0.5, dt=1.0), 6)
1.005
)")
      .def(py::init([](double kp, double ki, double kd, std::pair<double, double> limits, double filter) {
             return ForceController(kp, ki, kd, limits.first, limits.second, filter);
           }),
           "kp"_a, "ki"_a = 0.0, "kd"_a = 0.0, py::kw_only(), "output_limits"_a = std::make_pair(-10.0, 10.0),
           "derivative_filter"_a = 5.0)
      .def("update", &ForceController::update, "setpoint"_a, "force"_a, "dt"_a,
           "Velocity command [mm/s] from set-point and measured force [N], dt [ms] after the last update. "
           "ValueError on a value that is not finite or dt <= 0.")
      .def("set_gains", &ForceController::set_gains, "kp"_a, "ki"_a, "kd"_a = 0.0,
           "Sets the gains, without a jump of the integral term.")
      .def("reset", &ForceController::reset, "integral"_a = 0.0,
           "Resets the controller; the integral term starts at `integral` [mm/s].");
}
