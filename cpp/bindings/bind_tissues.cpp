#include "bindings.hpp"
#include "burrlab/tissues.hpp"

namespace {

std::string repr_of(const Tissue& t) {
  return format(
      "Tissue({!r}, label={}, c_e={!r}, alpha={!r}, colour={!r}, critical={}, bleeds={}, assumed={})", t.name,
      t.label, t.c_e, t.alpha, three(t.colour), t.critical, t.bleeds, t.assumed);
}

py::tuple fields(const Tissue& t) {
  return py::make_tuple(t.name, t.label, t.c_e, t.alpha, three(t.colour), t.critical, t.bleeds, t.assumed);
}

Tissue make(const py::object& name, const py::object& label, const py::object& c_e, const py::object& alpha,
            const py::object& colour_parts, bool critical, bool bleeds, bool assumed) {
  Tissue tissue;
  tissue.name = argument<py::str>("name", "text", name);
  tissue.label = argument<int>("label", "a whole number", label);
  tissue.c_e = argument<double>("c_e", "a number [N/mm^2]", c_e);
  tissue.alpha = argument<double>("alpha", "a number [1/ms]", alpha);
  const auto colour =
      argument<std::array<int, 3>>("colour", "three whole numbers (red, green, blue)", colour_parts);
  for (int i = 0; i < 3; ++i) {
    if (colour[i] < 0 || colour[i] > 255) refuse("every part of a colour", "0 to 255", colour[i]);
    tissue.colour[i] = static_cast<std::uint8_t>(colour[i]);
  }
  tissue.critical = critical;
  tissue.bleeds = bleeds;
  tissue.assumed = assumed;
  return tissue;
}

std::string names_of(const Tissues& tissues) {
  std::string names;
  for (const Tissue& tissue : tissues.all()) names += (names.empty() ? "" : ", ") + tissue.name;
  return names;
}

}  // namespace

void bind_tissues(py::module_& m) {
  Class<Tissue>(m, "Tissue", R"(A tissue: what a label of a segmentation stands for.

Parameters
----------
name : str
label : int
    Value in the label volume it was loaded from.
c_e : float
    Elastic constant of Eq. 3 [N/mm^2].
alpha : float
    Erosion rate of Eq. 4 [1/ms].
colour : (red, green, blue)
    0 to 255.
critical : bool
    The watch reports distances to it and injuries of it.
bleeds : bool
    It bleeds where it is opened.
assumed : bool
    c_e and alpha were not measured on this tissue. No tissue but bone has a published pair.

Raises
------
ValueError
    If a part of the colour is not 0 to 255.
)")
      .def(py::init(&make), "name"_a, py::kw_only(), "label"_a, "c_e"_a, "alpha"_a,
           "colour"_a = std::array<int, 3>{230, 220, 190}, "critical"_a = false, "bleeds"_a = false,
           "assumed"_a = true)
      .def_readonly("name", &Tissue::name)
      .def_readonly("label", &Tissue::label, "Value in the label volume")
      .def_readonly("c_e", &Tissue::c_e, "Elastic constant [N/mm^2]")
      .def_readonly("alpha", &Tissue::alpha, "Erosion rate [1/ms]")
      .def_readonly(
          "colour", [](const Tissue& t) { return three(t.colour); }, "(red, green, blue), 0 to 255")
      .def_readonly("critical", &Tissue::critical, "The watch reports distances to it and injuries of it")
      .def_readonly("bleeds", &Tissue::bleeds, "It bleeds where it is opened")
      .def_readonly("assumed", &Tissue::assumed, "c_e and alpha were not measured on this tissue")
      .def(
          "__eq__", [](const Tissue& a, const Tissue& b) { return fields(a).equal(fields(b)); },
          py::is_operator())
      .def("__hash__", [](const Tissue& t) { return py::hash(fields(t)); })
      .def("__repr__", &repr_of)
      .def(py::pickle(&fields, [](const py::tuple& t) {
        return make(t[0], t[1], t[2], t[3], t[4], t[5].cast<bool>(), t[6].cast<bool>(), t[7].cast<bool>());
      }));

  Class<Tissues, std::shared_ptr<Tissues>>(
      m, "Tissues", R"(The tissues of a bone; a tissue's number is its place among them.

Parameters
----------
tissues : list of Tissue
    1 to 64, with different names and labels; c_e from 1/4096 to 1000 N/mm^2, alpha zero or positive.
material : Material
    Gives c_e and alpha to tissues without their own, and f and both exponents to all; every burr in the bone
    has this material.

Raises
------
ValueError
    If there are none or more than 64, a name or label occurs twice, or a value is out of range.

Notes
-----
In the tick c_e counts in 1/4096 N/mm^2, so that sums over voxels are exact; `c_e` of a Tissue is not rounded.
)")
      .def(py::init([](const py::object& tissues, const Material& material) {
             return std::make_shared<Tissues>(
                 argument<std::vector<Tissue>>("tissues", "a list, each a Tissue", tissues), material);
           }),
           "tissues"_a, "material"_a)
      .def("__len__", &Tissues::size)
      .def("__iter__", [](const Tissues& t) { return py::iter(py::cast(t.all())); })
      .def("__getitem__",
           [](const Tissues& t, std::int64_t number) {
             const auto size = static_cast<std::int64_t>(t.size());
             if (number < -size || number >= size) throw py::index_error("no such tissue");
             return t[static_cast<std::size_t>(number < 0 ? number + size : number)];
           })
      .def(
          "number",
          [](const Tissues& t, const std::string& name) {
            const std::size_t number = t.find(name);
            if (number < t.size()) return number;
            throw std::invalid_argument("tissue must be one of " + names_of(t) + ", got '" + name + "'");
          },
          "name"_a, "Number of the tissue of this name. ValueError if there is none.")
      .def_readonly("material", &Tissues::material, "Material of every burr in the bone")
      .def(
          "__eq__",
          [](const Tissues& a, const Tissues& b) {
            return a.material() == b.material() && py::cast(a.all()).equal(py::cast(b.all()));
          },
          py::is_operator())
      .def("__repr__", [](const Tissues& t) { return "Tissues(" + names_of(t) + ")"; })
      .def(py::pickle([](const Tissues& t) { return py::make_tuple(t.all(), t.material()); },
                      [](const py::tuple& t) {
                        return std::make_shared<Tissues>(t[0].cast<std::vector<Tissue>>(),
                                                         t[1].cast<Material>());
                      }));
}
