#include "bindings.hpp"
#include "effects/effect_parameters.hpp"
#include "effects/instruments.hpp"

namespace {

EffectParameters make(const py::kwargs& values) {
  EffectParameters made;
  for (const auto& item : values) {
    const auto name = item.first.cast<std::string>();
    const EffectParameterRow* found = nullptr;
    for (const EffectParameterRow& row : effect_parameter_table())
      if (name == row.name) found = &row;
    if (!found) throw py::type_error("EffectParameters has no parameter '" + name + "'");
    py::detail::make_caster<double> number;
    if (!number.load(item.second, true)) throw py::type_error(name + " must be a number");
    made.*found->value = py::detail::cast_op<double>(number);
  }
  made.check();
  return made;
}

py::dict values_of(const EffectParameters& parameters) {
  py::dict out;
  for (const EffectParameterRow& row : effect_parameter_table()) {
    const double value = parameters.*row.value;
    out[row.name] = row.whole ? py::object(py::int_(std::int64_t(value))) : py::object(py::float_(value));
  }
  return out;
}

template <class Instrument>
Instrument checked(const Instrument& instrument) {
  instrument.check();
  return instrument;
}

}  // namespace

void bind_effect_parameters(py::module_& m) {
  auto parameters = Class<EffectParameters>(m, "EffectParameters",
                                            R"(Rates, sizes and friction of the secondary effects.

All but gravity are assumed: the paper gives no numbers. docs/effects.md gives their meaning.

Parameters
----------
**values : float
    By name; others keep their defaults. `table()` lists names, units and ranges.

Raises
------
ValueError
    If a value is out of range.
TypeError
    If there is no parameter of that name.

Examples
--------
>>> from burrlab.effects import EffectParameters
>>> EffectParameters(blood_rate=0.2).blood_rate
0.2
)");
  parameters.def(py::init(&make));
  for (const EffectParameterRow& row : effect_parameter_table()) {
    const std::string doc = *row.unit ? "[" + std::string(row.unit) + "]" : "";
    parameters.def_readonly(
        row.name, [&row](const EffectParameters& p) { return py::object(values_of(p)[row.name]); },
        doc.c_str());
  }
  parameters.def("to_dict", &values_of, "All values, for JSON.")
      .def_static(
          "table",
          [] {
            py::list rows;
            for (const EffectParameterRow& row : effect_parameter_table())
              rows.append(py::make_tuple(row.name, row.unit, row.least, row.most, row.assumed));
            return rows;
          },
          "[(name, unit, least, most, assumed)]")
      .def(
          "__eq__",
          [](const EffectParameters& a, const EffectParameters& b) {
            return values_of(a).equal(values_of(b));
          },
          py::is_operator())
      .def("__repr__",
           [](const EffectParameters& p) {
             const py::dict mine = values_of(p), usual = values_of(EffectParameters{});
             std::string text;
             for (const EffectParameterRow& row : effect_parameter_table())
               if (!mine[row.name].equal(usual[row.name]))
                 text += (text.empty() ? "" : ", ") + format("{}={!r}", row.name, mine[row.name]);
             return "EffectParameters(" + text + ")";
           })
      .def(py::pickle(&values_of, [](const py::dict& values) { return make(py::kwargs(values)); }));
  parameters.attr("__hash__") = py::none();

  const Nozzle nozzle;
  Class<Nozzle>(m, "Nozzle", R"(Irrigation.

Parameters
----------
position : (x, y, z)
    From the centre of its burr, or, with `burr=None`, in the bone frame [mm].
direction : (x, y, z)
    Of the jet; its length does not matter.
rate : float
    [mm^3/s]
speed : float
    Of the jet [mm/s].
burr : int or None
    Number of the burr it moves with.

Raises
------
ValueError
    If a value is not finite, the direction is zero, rate, speed or burr are negative, or rate or speed is
    above 1e6.
)")
      .def(py::init([](const Vec3& position, const Vec3& direction, double rate, double speed,
                       std::optional<int> burr) {
             if (burr && *burr < 0) refuse("burr of the nozzle", "0, 1 or None", *burr);
             return checked(Nozzle{position, direction, rate, speed, burr.value_or(-1)});
           }),
           "position"_a = nozzle.position, "direction"_a = nozzle.direction, py::kw_only(),
           "rate"_a = nozzle.rate, "speed"_a = nozzle.speed, "burr"_a = 0)
      .def_readonly("position", &Nozzle::position, "[mm]")
      .def_readonly("direction", &Nozzle::direction)
      .def_readonly("rate", &Nozzle::rate, "[mm^3/s]")
      .def_readonly("speed", &Nozzle::speed, "[mm/s]")
      .def_readonly("burr", [](const Nozzle& n) { return n.burr < 0 ? std::optional<int>() : n.burr; });

  const Sucker sucker;
  Class<Sucker>(m, "Sucker", R"(A sucker: takes up parcels near its tip, and draws the air around it.

Parameters
----------
position : (x, y, z)
    Of the tip, in the bone frame [mm].
radius : float
    Distance within which it takes up parcels [mm].
reach : float
    Distance within which it draws air [mm].
rate : float
    Most that it takes up [mm^3/s]. A parcel is never split; excess is owed by the next frame.
pull : float
    Air speed at `radius` [mm/s]; falls with the square of the distance.

Raises
------
ValueError
    If a value is not finite, the radius is not positive, the reach is less than the radius, or rate or pull
    is negative.
)")
      .def(py::init([](const Vec3& position, double radius, double reach, double rate, double pull) {
             return checked(Sucker{position, radius, reach, rate, pull});
           }),
           "position"_a, py::kw_only(), "radius"_a = sucker.radius, "reach"_a = sucker.reach,
           "rate"_a = sucker.rate, "pull"_a = sucker.pull)
      .def_readonly("position", &Sucker::position, "[mm]")
      .def_readonly("radius", &Sucker::radius, "[mm]")
      .def_readonly("reach", &Sucker::reach, "[mm]")
      .def_readonly("rate", &Sucker::rate, "[mm^3/s]")
      .def_readonly("pull", &Sucker::pull, "[mm/s]");

  const Camera camera;
  Class<Camera>(m, "Camera", R"(A perspective view.

Parameters
----------
position, look_at : (x, y, z)
    Bone frame [mm].
up : (x, y, z)
view_angle : float
    From the lower to the upper edge of the picture [degree], 1 to 170.
aspect : float
    Width over height of the picture.

Raises
------
ValueError
    If a value is not finite or out of range, `look_at` is the position, or `up` lies along the view.
)")
      .def(py::init([](const Vec3& position, const Vec3& look_at, const Vec3& up, double angle,
                       double aspect) { return checked(Camera{position, look_at, up, angle, aspect}); }),
           "position"_a, "look_at"_a, py::kw_only(), "up"_a = camera.up, "view_angle"_a = camera.view_angle,
           "aspect"_a = camera.aspect)
      .def_readonly("position", &Camera::position, "[mm]")
      .def_readonly("look_at", &Camera::look_at, "[mm]")
      .def_readonly("up", &Camera::up)
      .def_readonly("view_angle", &Camera::view_angle, "[degree]")
      .def_readonly("aspect", &Camera::aspect);
}
