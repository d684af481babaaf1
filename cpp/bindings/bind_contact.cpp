#include <algorithm>

#include "contact_series.hpp"

namespace py = pybind11;
using namespace burrlab;

namespace {

template <class Get>
auto column(Get get) {
  return [get](const ContactSeries& series) {
    using Value = decltype(get(series.contacts[0]));
    py::array_t<Value> out(static_cast<py::ssize_t>(series.contacts.size()));
    std::transform(series.contacts.begin(), series.contacts.end(), out.mutable_data(), get);
    return out;
  };
}

template <class Get>
auto vectors(Get get) {
  return [get](const ContactSeries& series) {
    py::array_t<double> out({static_cast<py::ssize_t>(series.contacts.size()), py::ssize_t{3}});
    double* row = out.mutable_data();
    for (const Contact& contact : series.contacts) {
      const Vec3& v = get(contact);
      row = std::copy(v.data(), v.data() + 3, row);
    }
    return out;
  };
}

py::array_t<double> to_array(const std::vector<double>& values) {
  return py::array_t<double>(static_cast<py::ssize_t>(values.size()), values.data());
}

}  // namespace

void bind_contact(py::module_& m) {
  py::class_<Contact>(m, "Contact",
                      "One tick as felt: the force is that of the state before the tick's erosion.")
      .def_property_readonly(
          "force", [](const Contact& c) { return c.force; }, "(3,) [N], out of the bone; a copy")
      .def_property_readonly(
          "normal", [](const Contact& c) { return c.normal; },
          "(3,) out of the bone; shorter than 1 where ambiguous; a copy")
      .def_readonly("penetration", &Contact::penetration, "Effective depth h, Eq. 2 [mm]")
      .def_readonly(
          "c_e", &Contact::c_e,
          "Elastic constant of Eq. 3: in a bone with tissues the mean over the mass inside the sphere; "
          "without any of it the material's [N/mm^2]")
      .def_readonly("m0", &Contact::m0, "[mm^3]")
      .def_property_readonly(
          "m1", [](const Contact& c) { return c.m1; }, "(3,) [mm^4]; a copy")
      .def_readonly("removed", &Contact::removed, "Solid bone removed in the tick [mm^3]")
      .def_readonly("tick", &Contact::tick, "Number of the tick")
      .def_readonly("touching", &Contact::touching, "There is bone inside the sphere")
      .def_readonly("ambiguous", &Contact::ambiguous, "|m_1| < 0.1 m_0 R: no direction, the force fades")
      .def_readonly("coarse", &Contact::coarse, "The radius is below 7.5 voxels")
      .def_readonly("faint", &Contact::faint,
                    "Over 5 % of the contact lies in voxels with pristine level below 32, where `layer` errs")
      .def("__repr__", [](const Contact& c) {
        return std::string(py::str("Contact(tick={}, force=({:.4g}, {:.4g}, {:.4g}) N, penetration={:.4g} "
                                   "mm, removed={:.3g} mm^3{}{}{})")
                               .format(c.tick, c.force[0], c.force[1], c.force[2], c.penetration, c.removed,
                                       c.ambiguous ? ", ambiguous" : "", c.coarse ? ", coarse" : "",
                                       c.faint ? ", faint" : ""));
      });

  py::class_<ContactSeries>(m, "ContactSeries",
                            "The contacts along a path; every column is a copy with one row a tick.")
      .def("__len__", [](const ContactSeries& s) { return s.contacts.size(); })
      .def("__getitem__",
           [](const ContactSeries& s, py::ssize_t i) {
             const auto n = static_cast<py::ssize_t>(s.contacts.size());
             if (i < -n || i >= n)
               throw py::index_error("tick " + std::to_string(i) + " of " + std::to_string(n));
             return s.contacts[static_cast<std::size_t>(i < 0 ? i + n : i)];
           })
      .def_property_readonly("force", vectors([](const Contact& c) -> const Vec3& { return c.force; }),
                             "(n, 3) [N]")
      .def_property_readonly("normal", vectors([](const Contact& c) -> const Vec3& { return c.normal; }),
                             "(n, 3)")
      .def_property_readonly("m1", vectors([](const Contact& c) -> const Vec3& { return c.m1; }),
                             "(n, 3) [mm^4]")
      .def_property_readonly("penetration", column([](const Contact& c) { return c.penetration; }),
                             "(n,) [mm]")
      .def_property_readonly("c_e", column([](const Contact& c) { return c.c_e; }), "(n,) [N/mm^2]")
      .def_property_readonly("m0", column([](const Contact& c) { return c.m0; }), "(n,) [mm^3]")
      .def_property_readonly("removed", column([](const Contact& c) { return c.removed; }), "(n,) [mm^3]")
      .def_property_readonly("tick", column([](const Contact& c) { return c.tick; }), "(n,)")
      .def_property_readonly("touching", column([](const Contact& c) { return c.touching; }), "(n,)")
      .def_property_readonly("ambiguous", column([](const Contact& c) { return c.ambiguous; }), "(n,)")
      .def_property_readonly("coarse", column([](const Contact& c) { return c.coarse; }), "(n,)")
      .def_property_readonly("faint", column([](const Contact& c) { return c.faint; }), "(n,)");

  py::class_<HeldDescent>(m, "HeldDescent", "A descent under an exactly constant force, tick by tick.")
      .def_property_readonly(
          "position", [](const HeldDescent& d) { return to_array(d.position); },
          "(n,) along the axis from the start, before each tick's erosion [mm]")
      .def_property_readonly(
          "force", [](const HeldDescent& d) { return to_array(d.force); }, "(n,) axial, as solved [N]")
      .def_property_readonly(
          "removed", [](const HeldDescent& d) { return to_array(d.removed); }, "(n,) [mm^3]")
      .def_readonly("ambiguous", &HeldDescent::ambiguous, "Number of ticks whose contact had no direction")
      .def_readonly("faint", &HeldDescent::faint,
                    "Number of ticks with over 5 % of the contact in voxels with pristine level below 32")
      .def_readonly("reached", &HeldDescent::reached, "Came to the end of its travel.");
}
