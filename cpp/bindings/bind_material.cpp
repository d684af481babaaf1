#include "bindings.hpp"
#include "burrlab/check.hpp"
#include "burrlab/depth_table.hpp"
#include "burrlab/material.hpp"
#include "burrlab/shape.hpp"

namespace {

void bind_shape(py::module_& m) {
  py::class_<Shape>(m, "Shape", R"doc(Erosion shape function f(x), x = r/R, of Eq. 4.

The paper asks only for a maximum at r = 0 and zero beyond R. The family is our choice; an alpha belongs to
one f.

Parameters
----------
name : str
    ``"parabolic"`` 1 - x^2, ``"linear"`` 1 - x, ``"quartic"`` (1 - x^2)^2, ``"constant"`` 1, or
    ``"power(k)"`` (1 - x^2)^k with 0 < k <= 8.

Raises
------
ValueError
    If the name is none of these or k is out of range.

Examples
--------
>>> import burrlab
>>> f = burrlab.Shape("power(1.5)")
>>> f.name, f.order, round(f(0.5), 4)
('power(1.5)', 1.5, 0.6495)
)doc")
      .def(py::init(&Shape::parse), "name"_a)
      .def_property_readonly("name", &Shape::name, "Name that gives the same shape.")
      .def_property_readonly("order", &Shape::order,
                             "Order of the zero of f at x = 1: 0 for constant, 1 for linear, k for power(k).")
      .def(
          "__call__",
          [](const Shape& f, const py::array_t<double, py::array::forcecast>& x) {
            return py::vectorize([&f](double r) {
              if (!(r >= 0.0)) refuse("x", "r/R, zero or positive", r);
              return f.at_radius(r);
            })(x);
          },
          "x"_a, "f at x = r/R >= 0 (scalar or array); zero beyond 1.")
      .def(
          "__eq__", [](const Shape& a, const Shape& b) { return a == b; }, py::is_operator())
      .def("__hash__", [](const Shape& f) { return py::hash(py::str(f.name())); })
      .def("__repr__", [](const Shape& f) { return "Shape('" + f.name() + "')"; })
      .def("__str__", &Shape::name)
      .def(py::pickle([](const Shape& f) { return f.name(); },
                      [](const std::string& name) { return Shape::parse(name); }));

  m.attr("shape_names") = py::tuple(py::cast(Shape::names()));  // apart from power(k)
  m.def("shape_kappa", &Shape::kappa, "shape"_a,
        "Factor of the leading term at the burr's surface: f = kappa (1 - x)^order + ...");
  m.def(
      "depth_table",
      [](double order) {
        const auto table = DepthTable::of_order(order);
        return to_array(table->nodes().data(), {DepthTable::rows, DepthTable::columns});
      },
      "order"_a,
      "G(e, tau) of the scheme `layer` at e = 0, 1/8 .. 3 (rows) and tau = 0, 1/40 .. 1 (columns), (25, 41) "
      "float32; a copy.");
}

}  // namespace

void bind_material(py::module_& m) {
  bind_shape(m);
  py::class_<Burr>(m, "Burr", R"(A spherical burr.

Parameters
----------
radius : float
    R [mm]; surgical burrs have 1 to 5 mm.

Raises
------
ValueError
    If the radius is not positive and finite.

Examples
--------
>>> import burrlab
>>> burrlab.Burr(3.0)
Burr(radius=3.0)
)")
      .def(py::init<double>(), "radius"_a)
      .def_readonly("radius", &Burr::radius, "R [mm]")
      .def(
          "__eq__", [](const Burr& a, const Burr& b) { return a == b; }, py::is_operator())
      .def("__hash__", [](const Burr& b) { return py::hash(py::float_(b.radius)); })
      .def("__repr__",
           [](const Burr& b) { return "Burr(radius=" + std::string(py::str(py::float_(b.radius))) + ")"; })
      .def(py::pickle(copy_of(&Burr::radius), [](double radius) { return Burr(radius); }));

  py::class_<Material>(
      m, "Material", R"(A material: elastic constant, erosion rate, and the shape f that the rate belongs to.

Parameters
----------
name : str
c_e : float
    Elastic constant of Eq. 3 [N/mm^2].
alpha : float
    Erosion rate of Eq. 4 [1/ms], for one `shape`, drill, burr type and speed.
shape : Shape or str
    Erosion shape function f.
source : str
    Source of the numbers.

Raises
------
ValueError
    If c_e is not positive, alpha negative, either not finite, or the shape unknown.

Notes
-----
The unit of c_e follows from F = c_e R^2 (h/R)^(3/2). Only an alpha per millisecond gives the paper's
millimetres in seconds. Both units are our decisions: the paper prints none.

Examples
--------
>>> import burrlab
>>> burrlab.Material("test block", c_e=2.0, alpha=0.1)
Material('test block', c_e=2.0, alpha=0.1, shape='parabolic', source='')
)")
      .def(
          py::init([](const py::str& name, double c_e, double alpha, const ShapeArgument& shape,
                      const py::str& source) { return Material(name, c_e, alpha, to_shape(shape), source); }),
          "name"_a, py::kw_only(), "c_e"_a, "alpha"_a, "shape"_a = "parabolic", "source"_a = "")
      .def_readonly("name", &Material::name)
      .def_readonly("c_e", &Material::c_e, "Elastic constant [N/mm^2]")
      .def_readonly("alpha", &Material::alpha, "Erosion rate [1/ms]")
      .def_readonly("shape", &Material::shape, "Erosion shape function")
      .def_readonly("source", &Material::source, "Source of the numbers")
      .def(
          "__eq__", [](const Material& a, const Material& b) { return a == b; }, py::is_operator())
      .def("__hash__",
           [](const Material& a) { return py::hash(py::make_tuple(a.name, a.c_e, a.alpha, a.shape.name())); })
      .def("__repr__",
           [](const Material& a) {
             return format("Material({!r}, c_e={!r}, alpha={!r}, shape={!r}, source={!r})", a.name, a.c_e,
                           a.alpha, a.shape.name(), a.source);
           })
      .def(py::pickle(
          [](const Material& a) { return py::make_tuple(a.name, a.c_e, a.alpha, a.shape, a.source); },
          [](const py::tuple& t) {
            return Material(t[0].cast<std::string>(), t[1].cast<double>(), t[2].cast<double>(),
                            t[3].cast<Shape>(), t[4].cast<std::string>());
          }));
}
