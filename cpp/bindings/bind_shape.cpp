#include "bindings.hpp"
#include "burrlab/check.hpp"
#include "burrlab/depth_table.hpp"
#include "burrlab/shape.hpp"

namespace py = pybind11;
using burrlab::Shape;

void bind_shape(py::module_& m) {
  py::class_<Shape>(m, "Shape", R"doc(Erosion shape function f(x), x = r/R, of Eq. 4.

The paper asks only for a maximum at r = 0 and zero beyond R; the family is our choice, and an alpha is a
number for one f.

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
      .def(py::init(&Shape::parse), py::arg("name"))
      .def_property_readonly("name", &Shape::name, "Name that makes the same shape again.")
      .def_property_readonly("order", &Shape::order,
                             "Order of the zero of f at x = 1: 0 for constant, 1 for linear, k for power(k).")
      .def(
          "__call__",
          [](const Shape& f, const py::array_t<double, py::array::forcecast>& x) {
            return py::vectorize([&f](double r) {
              if (!(r >= 0.0)) burrlab::refuse("x", "r/R, zero or positive", r);
              return f.at_radius(r);
            })(x);
          },
          py::arg("x"), "f at x = r/R >= 0 (scalar or array); zero beyond 1.")
      .def(
          "__eq__", [](const Shape& a, const Shape& b) { return a == b; }, py::is_operator())
      .def("__hash__", [](const Shape& f) { return py::hash(py::str(f.name())); })
      .def("__repr__", [](const Shape& f) { return "Shape('" + f.name() + "')"; })
      .def("__str__", &Shape::name)
      .def(py::pickle([](const Shape& f) { return f.name(); },
                      [](const std::string& name) { return Shape::parse(name); }));

  m.def(
      "depth_table",
      [](double order) {
        const auto table = burrlab::DepthTable::of_order(order);
        py::array_t<float> nodes({burrlab::DepthTable::rows, burrlab::DepthTable::columns});
        std::copy(table->nodes().begin(), table->nodes().end(), nodes.mutable_data());
        return nodes;
      },
      py::arg("order"),
      "G(e, tau) of the scheme `layer` at e = 0, 1/8 .. 3 (rows) and tau = 0, 1/40 .. 1 (columns); a copy, "
      "(25, 41) float32.");
}
