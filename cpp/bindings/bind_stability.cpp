#include "bindings.hpp"
#include "session/contact_stiffness.hpp"
#include "session/passivity_observer.hpp"

namespace {

py::array_t<double> passivity_energy(const Reals& position, const Reals& force) {
  for (const Reals* array : {&position, &force})
    if (array->ndim() != 2 || array->shape(1) != 3 || array->shape(0) != position.shape(0))
      throw std::invalid_argument("position and force must have one shape (n, 3)");
  py::array_t<double> out(position.shape(0));
  PassivityObserver observer;
  for (py::ssize_t i = 0; i < position.shape(0); ++i) {
    observer.update({position.at(i, 0), position.at(i, 1), position.at(i, 2)},
                    {force.at(i, 0), force.at(i, 1), force.at(i, 2)});
    out.mutable_at(i) = observer.energy();
  }
  return out;
}

}  // namespace

void bind_stability(py::module_& m) {
  m.def("flat_contact_area", &flat_contact_area, "radius"_a, "penetration"_a,
        "Wetted area on flat bone, projected on the normal: pi (2 R h - h^2) [mm^2]. ValueError unless h is "
        "0 to 2 R.");
  m.def("hole_contact_area", &hole_contact_area, "radius"_a, "depth"_a,
        "Wetted area in the burr's own hole of depth H: pi (2 R H - H^2) [mm^2]. ValueError unless H is 0 to "
        "2 R.");
  m.def("contact_stiffness", &contact_stiffness, "force"_a, "area"_a, py::kw_only(), "radius"_a, "c_e"_a,
        "k = dF/dH = 1.5 c_e sqrt(u) A/(pi R (2 u - u^2)) [N/mm] at a force [N] and a wetted area A [mm^2]. "
        "ValueError on a negative force or area.");
  m.def("contact_area", &contact_area, "force"_a, "stiffness"_a, py::kw_only(), "radius"_a, "c_e"_a,
        "The wetted area [mm^2] that gives this stiffness [N/mm]. ValueError on a negative force or "
        "stiffness.");
  m.def("measured_stiffness", &measured_stiffness, "executor"_a, "burr"_a, "center"_a, "step"_a = 0.02,
        "k from the force `step` [mm] in and out along the contact's normal [N/mm]; 0 without contact.");
  m.def(
      "stiffest_contact",
      [](const TickExecutor& executor, std::size_t burr, const Vec3& center, double step) {
        const StiffestContact contact = stiffest_contact(executor, burr, center, step);
        return py::make_tuple(contact.stiffness, contact.direction);
      },
      "executor"_a, "burr"_a, "center"_a, "step"_a = 0.02,
      "(stiffness [N/mm], unit vector) of the direction in which the contact at a centre [mm] is stiffest; 0 "
      "without contact.");
  m.def("passivity_limit", &passivity_limit, "damping"_a, "period"_a, "age"_a = 0.0,
        "virtual_damping"_a = 0.0,
        "(b - |B|)/(T/2 + t_d) [N/mm]; dampings [N s/m], period and age of the position [ms] "
        "(docs/stability.md).");
  m.def("encoder_limit", &encoder_limit, "friction"_a, "encoder_step"_a,
        "2 f_c/Delta [N/mm]; friction [N], step [mm]; infinite for a step of 0 (docs/stability.md).");
  m.def("force_at_limit", &force_at_limit, "limit"_a, "area"_a, py::kw_only(), "radius"_a, "c_e"_a,
        "Force [N] below which a contact of this wetted area [mm^2] is stiffer than `limit` [N/mm].");
  m.def("passivity_energy", &passivity_energy, "position"_a, "force"_a,
        "Energy given to the hand minus taken from it, up to each tick [mJ], (n,), from the device's "
        "positions [mm] and the forces sent [N], each held to the next tick, (n, 3). ValueError if the "
        "shapes differ or are not (n, 3).");

  py::class_<StabilityReport>(m, "StabilityReport", "The stability that a session reports; nan if unknown.")
      .def_readonly("force", &StabilityReport::force, "[N]")
      .def_readonly("k", &StabilityReport::k, "Contact stiffness, in series with a coupling [N/mm]")
      .def_readonly("area", &StabilityReport::area, "Wetted area that gives k [mm^2]")
      .def_readonly("limit", &StabilityReport::limit, "The lower of the next two [N/mm]")
      .def_readonly("sampling_limit", &StabilityReport::sampling_limit, "(b - |B|)/(T/2 + t_d) [N/mm]")
      .def_readonly("quantisation_limit", &StabilityReport::quantisation_limit, "2 f_c/Delta [N/mm]")
      .def_readonly("ratio", &StabilityReport::ratio, "k/limit")
      .def_readonly("force_at_limit", &StabilityReport::force_at_limit,
                    "Force below which k exceeds the limit in this hole [N]")
      .def_readonly("warning", &StabilityReport::warning, "The ratio is above 0.8")
      .def("__repr__", [](const StabilityReport& r) {
        return format(
            "StabilityReport(force={:.3g} N, k={:.3g} N/mm, limit={:.3g} N/mm, ratio={:.2f}, "
            "force_at_limit={:.3g} N)",
            r.force, r.k, r.limit, r.ratio, r.force_at_limit);
      });
  const double nan = std::numeric_limits<double>::quiet_NaN();
  m.def(
      "stability_report",
      [](double force, double stiffness, const Burr& burr, const Material& material, double period,
         double damping, double encoder_step, double friction, double age, double virtual_damping,
         double coupling) {
        return stability_report(force, stiffness, {burr, material}, {damping, encoder_step, friction}, period,
                                age, virtual_damping, coupling);
      },
      "force"_a, "stiffness"_a, "burr"_a, "material"_a, py::kw_only(), "period"_a, "damping"_a = nan,
      "encoder_step"_a = nan, "friction"_a = nan, "age"_a = 0.0, "virtual_damping"_a = 0.0,
      "coupling"_a = std::numeric_limits<double>::infinity(),
      "Contact stiffness along the normal [N/mm] against its limits. `force` of the contact [N], `period` of "
      "the loop and `age` of the position [ms]; `damping` of device and hand and `virtual_damping` [N s/m]; "
      "`encoder_step` [mm]; `friction` of the device [N]; nan if unknown. `coupling`: stiffness of the "
      "virtual coupling [N/mm]. ValueError if force, stiffness, damping, step or friction are negative, or "
      "period or coupling not positive.");
}
