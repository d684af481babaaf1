#include <algorithm>

#include "bindings.hpp"
#include "session/hand_device.hpp"
#include "session/scripted_device.hpp"
#include "session/servo_device.hpp"

namespace {

using Flags = py::array_t<bool, py::array::c_style | py::array::forcecast>;

/// Rows of `columns`, or, without columns, of a value each.
template <class Array>
void require_rows(const char* name, const Array& array, py::ssize_t rows, py::ssize_t columns) {
  const bool fits =
      array.ndim() == (columns ? 2 : 1) && array.shape(0) == rows && (!columns || array.shape(1) == columns);
  if (fits) return;
  throw std::invalid_argument(
      name + (" must have shape (n," + (columns ? " " + std::to_string(columns) : "")) + "), one " +
      (columns ? "row" : "value") + " for each of the " + std::to_string(rows) + " rows");
}

Vec3 row_of(const Reals& array, py::ssize_t i) { return {array.at(i, 0), array.at(i, 1), array.at(i, 2)}; }

Quaternion quaternion_of(const std::optional<Reals>& table, py::ssize_t i) {
  if (!table) return {1.0, 0.0, 0.0, 0.0};
  return {table->at(i, 0), table->at(i, 1), table->at(i, 2), table->at(i, 3)};
}

std::shared_ptr<ScriptedDevice> scripted(const Reals& time, const Reals& position,
                                         const std::optional<Flags>& on,
                                         const std::optional<Reals>& orientation) {
  if (time.ndim() != 1) throw std::invalid_argument("time must have shape (n,)");
  const py::ssize_t n = time.shape(0);
  require_rows("position", position, n, 3);
  if (on) require_rows("on", *on, n, 0);
  if (orientation) require_rows("orientation", *orientation, n, 4);
  std::vector<ScriptedDevice::Row> rows;
  for (py::ssize_t i = 0; i < n; ++i)
    rows.push_back({time.at(i), row_of(position, i), on ? on->at(i) : true, quaternion_of(orientation, i)});
  return std::make_shared<ScriptedDevice>(std::move(rows));
}

py::array_t<double> path_of(const ScriptedDevice& device) {
  py::array_t<double> out({py::ssize_t(device.rows().size()), py::ssize_t(4)});
  double* at = out.mutable_data();
  for (const ScriptedDevice::Row& row : device.rows()) {
    *at++ = row.time;
    at = std::copy_n(row.position.data(), 3, at);
  }
  return out;
}

std::shared_ptr<ReplayDevice> replay(const Reals& position, const std::optional<Reals>& velocity,
                                     const std::optional<Flags>& on, const std::optional<Reals>& orientation,
                                     const std::optional<Places>& buttons) {
  const py::ssize_t n = position.ndim() > 0 ? position.shape(0) : 0;
  require_rows("position", position, n, 3);
  if (velocity) require_rows("velocity", *velocity, n, 3);
  if (on) require_rows("on", *on, n, 0);
  if (orientation) require_rows("orientation", *orientation, n, 4);
  if (buttons) require_rows("buttons", *buttons, n, 0);
  std::vector<DeviceReading> ticks;
  for (py::ssize_t i = 0; i < n; ++i) {
    if (buttons && (buttons->at(i) < 0 || buttons->at(i) > 255))
      refuse("buttons", "0 to 255", double(buttons->at(i)));
    ticks.push_back({row_of(position, i), velocity ? row_of(*velocity, i) : Vec3(Vec3::Zero()),
                     quaternion_of(orientation, i), buttons ? std::uint8_t(buttons->at(i)) : std::uint8_t(0),
                     on ? on->at(i) : true});
  }
  return std::make_shared<ReplayDevice>(std::move(ticks));
}

void bind_hand(py::module_& m) {
  const HandSettings defaults;
  const auto setting = [](double HandSettings::* field) {
    return [field](const HandDevice& hand) { return hand.settings().*field; };
  };
  Class<HandDevice, Device, std::shared_ptr<HandDevice>>(m, "HandDevice",
                                                         R"(A simulated hand that holds a simulated device.

A point mass with damping and friction. A spring, the grip, draws it to the hand's target. Along `into` the
target moves, at most at `approach`, to where the spring pushes with `push`. Out of contact this is a gentle
approach; at rest on bone the force is exactly `push`; a burr that sinks at v is pushed with grip v follow and
damping v less. Strokes move the target along `along` by amplitude sin(2 pi strokes t). The loop's force is
held between readings. Deterministic.

Parameters
----------
start : (x, y, z)
    Centre of the burr at the start, out of contact [mm].
into : (x, y, z)
    Unit vector into the bone.
along : (x, y, z)
    Unit vector of the strokes, perpendicular to `into`.
push : float
    Static force into the bone [N].
presses : float
    Presses per second, of height `push`, from the first contact on; 0 for a steady push.
amplitude : float
    Of a stroke [mm].
strokes : float
    Full turns per second, out, back and home; 0 for a still push.
strokes_after : float
    Start of the strokes; they grow to their amplitude over a second [s].
approach : float
    Speed of the hand towards the bone [mm/s].
follow : float
    Time constant of the hand's giving way to the push [ms].
mass : float
    Of hand and device [kg].
damping : float
    Of hand and device [N s/m].
grip : float
    Spring between the hand's target and the device [N/mm].
friction : float
    Coulomb friction of the device, against its motion [N].
encoder_step : float
    Positions are read to the nearest multiple on each axis [mm]; 0: exactly.
on : bool
    The burr turns,
on_after : float
    but not before this time [s].

Raises
------
ValueError
    If a value is not finite or out of range, a vector is not of length 1, or the two are not perpendicular.

Notes
-----
The push rises for a quarter of a press, is held for three tenths, falls for a quarter and is zero
for a fifth; rise and fall are x^2 (3 - 2x). The target follows the change of the push at once, so `follow`
does not flatten a press.

The defaults are ours. The reported velocity is the difference of two readings over the time between them,
unfiltered, as from an encoder. Integrated in steps of at most 20 us.

Examples
--------
>>> import burrlab
>>> hand = burrlab.HandDevice(start=(0, 0, 3.2), push=0.5, strokes=0)
>>> hand.position
array([0. , 0. , 3.2])
)")
      .def(py::init([](const py::object& start, const Vec3& into, const Vec3& along, double push,
                       double presses, double amplitude, double strokes, double strokes_after,
                       double approach, double follow, double mass, double damping, double grip,
                       double friction, double encoder_step, bool on, double on_after) {
             return std::make_shared<HandDevice>(HandSettings{
                 to_point("start", start), into, along, push, presses, amplitude, strokes, strokes_after,
                 approach, follow, mass, damping, grip, friction, encoder_step, on, on_after});
           }),
           "start"_a = defaults.start, py::kw_only(), "into"_a = defaults.into, "along"_a = defaults.along,
           "push"_a = defaults.push, "presses"_a = defaults.presses, "amplitude"_a = defaults.amplitude,
           "strokes"_a = defaults.strokes, "strokes_after"_a = defaults.strokes_after,
           "approach"_a = defaults.approach, "follow"_a = defaults.follow, "mass"_a = defaults.mass,
           "damping"_a = defaults.damping, "grip"_a = defaults.grip, "friction"_a = defaults.friction,
           "encoder_step"_a = defaults.encoder_step, "on"_a = defaults.on, "on_after"_a = defaults.on_after)
      .def_readonly("force", &HandDevice::force, "(3,) last sent by the loop [N]; a copy")
      .def_readonly("position", &HandDevice::position, "(3,) true position [mm]; while no loop runs")
      .def_readonly("target", &HandDevice::target, "(3,) place the hand draws to [mm]; while no loop runs")
      .def_readonly("damping", setting(&HandSettings::damping), "[N s/m]")
      .def_readonly("friction", setting(&HandSettings::friction), "[N]")
      .def_readonly("encoder_step", setting(&HandSettings::encoder_step), "[mm]");
}

constexpr const char* servo_text = R"({}

Written from the public documentation and tested against a stub of ours, not on hardware. The library is loaded
when it is needed; its axes are {}

Parameters
----------
{} : {}
    Of the device{}
lost_after : float
    Age at which a position is lost, and the session stops [ms].
on_button : int, optional
    The burr turns while this button, 0 to 7, is pressed; default always.
library : str
    File of {}

Raises
------
ValueError
    If the library cannot be loaded, is for another processor or lacks a function, there is no device of this
    {}, it is open already, or it must be calibrated.

Notes
-----
The device is open while this object lives. Its servo runs during a session, {} times a second. An error
of the library, an orientation that is not a rotation or no position for `lost_after` ends the session with
force zero.{}
)";

/// A vendor's device, which its library knows by `id`; `text` fills `servo_text`.
template <class Vendor, class Id, class... Text>
auto bind_vendor(py::module_& m, const char* title, const char* id, const Id& usual, const Text&... text) {
  Class<Vendor, ServoDevice, std::shared_ptr<Vendor>> device(m, title, format(servo_text, text...).c_str());
  device.def(py::init([](const Id& which, double lost_after, std::optional<int> on_button,
                         const std::string& library) {
               const ServoSettings settings{lost_after, button_of(on_button)};
               return without_gil([&] { return std::make_shared<Vendor>(which, settings, library); });
             }),
             py::arg(id) = usual, py::kw_only(), "lost_after"_a = 100.0, "on_button"_a = py::none(),
             "library"_a = "");
  return device;
}

void bind_servo(py::module_& m) {
  Class<ServoDevice, Device, std::shared_ptr<ServoDevice>>(m, "ServoDevice",
                                                           "A device that a vendor's library drives.")
      .def_readonly("fault", &ServoDevice::fault,
                    "Why the device was lost, in one sentence; empty without a fault of the device")
      .def_readonly(
          "delay", [](const ServoDevice& d) { return d.model().delay; },
          "From reading a position to the middle of the time in which its force acts [ms]: a mean over about "
          "a thousand cycles of the servo; nan before the first")
      .def_readonly("hardware", &ServoDevice::hardware, "The model, as the vendor's library names it")
      .def_readonly("library", &ServoDevice::library, "File of the vendor's library");
  bind_vendor<TouchDevice>(
      m, "TouchDevice", "name", std::string(),
      "A Touch or PHANToM, over 3D Systems' library libHD (OpenHaptics).",
      "x right, y up, z towards the user [mm]. The orientation turns the stylus's axes\ninto these.", "name",
      "str", " in the vendor's set-up; empty for the default device.",
      "libHD; default what the environment's BURRLAB_LIBHD names, else libHD.so or hd.dll where the system\n"
      "    looks.",
      "name", "about 1000", "");
  bind_vendor<OmegaDevice>(
      m, "OmegaDevice", "index", 0,
      "An Omega, Delta, Sigma or Falcon, over Force Dimension's library libdhd.",
      "x towards the user, y right, z up [mm]. The orientation turns the handle's axes\ninto these; it is 1 "
      "for "
      "a device without a wrist.",
      "index", "int", ", from 0.",
      "libdhd; default what the environment's BURRLAB_LIBDHD names, else libdhd.so.3 or dhd64.dll where the\n"
      "    system looks.",
      "index", "up to 4000", " The library adds the force that carries the device's own weight.")
      .def_static("count", &OmegaDevice::count, "library"_a = "", no_gil,
                  "Number of devices that the library finds. ValueError as above for the library.");
}

}  // namespace

void bind_device(py::module_& m) {
  bind_hand(m);
  bind_servo(m);
  Class<ScriptedDevice, Device, std::shared_ptr<ScriptedDevice>>(
      m, "ScriptedDevice", R"(A device that moves along straight lines between the rows of a table.

It stays at the first row until its time. After the last row the session ends.

Parameters
----------
time : array_like, shape (n,)
    Since the session's start, increasing [s].
position : array_like, shape (n, 3)
    Centre of the burr [mm].
on : array_like of bool, shape (n,), optional
    Whether the burr turns from this row to the next; default True.
orientation : array_like, shape (n, 4), optional
    Unit quaternions (w, x, y, z) that turn directions of the tool into those of the bone; between two rows the
    shorter way. Default 1.

Raises
------
ValueError
    If there is no row, a number is not finite, the times do not increase, an orientation is not of length 1,
    or shapes do not fit.
)")
      .def(py::init(&scripted), "time"_a, "position"_a, "on"_a = py::none(), "orientation"_a = py::none())
      .def("__len__", [](const ScriptedDevice& d) { return d.rows().size(); })
      .def_readonly("duration", &ScriptedDevice::duration, "Time of the last row [s]")
      .def_readonly("path", &path_of, "(n, 4) time [s] and position [mm] of each row; a copy")
      .def_readonly("force", &ScriptedDevice::force, "(3,) last sent by the loop [N]; a copy");
  Class<ReplayDevice, Device, std::shared_ptr<ReplayDevice>>(
      m, "ReplayDevice", R"(A device that repeats the positions of recorded ticks, then ends the session.

Parameters
----------
position : array_like, shape (n, 3)
    Of the device [mm].
velocity : array_like, shape (n, 3), optional
    [mm/s]; default 0.
on : array_like of bool, shape (n,), optional
    Whether the burr turned; default True.
orientation : array_like, shape (n, 4), optional
    Unit quaternions (w, x, y, z) that turn directions of the tool into those of the bone; default 1.
buttons : array_like of int, shape (n,), optional
    Bit i is button i; default 0.

Raises
------
ValueError
    If there is no tick, a number is not finite, buttons are out of range, an orientation is not of
    length 1, or shapes do not fit.
)")
      .def(py::init(&replay), "position"_a, "velocity"_a = py::none(), "on"_a = py::none(),
           "orientation"_a = py::none(), "buttons"_a = py::none())
      .def("__len__", &ReplayDevice::size)
      .def_readonly("force", &ReplayDevice::force, "(3,) last sent by the loop [N]; a copy");
}
