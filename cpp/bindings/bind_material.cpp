#include "bindings.hpp"
#include "burrlab/burr.hpp"
#include "burrlab/material.hpp"

namespace py = pybind11;
using burrlab::Burr;
using burrlab::Material;
using burrlab::Shape;

void bind_material(py::module_& m) {
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
      .def(py::init<double>(), py::arg("radius"))
      .def_readonly("radius", &Burr::radius, "R [mm]")
      .def(
          "__eq__", [](const Burr& a, const Burr& b) { return a == b; }, py::is_operator())
      .def("__hash__", [](const Burr& b) { return py::hash(py::float_(b.radius)); })
      .def("__repr__",
           [](const Burr& b) { return "Burr(radius=" + std::string(py::str(py::float_(b.radius))) + ")"; })
      .def(py::pickle([](const Burr& b) { return b.radius; }, [](double radius) { return Burr(radius); }));

  py::class_<Material>(
      m, "Material", R"(What a burr meets: elastic constant, erosion rate, and the f that the rate belongs to.

Parameters
----------
name : str
c_e : float
    Elastic constant of Eq. 3 [N/mm^2].
alpha : float
    Erosion rate of Eq. 4 [1/ms]. It is a number for one `shape`, and for one drill, burr type and speed.
shape : Shape or str
    Erosion shape function f.
source : str
    Where the numbers come from.

Raises
------
ValueError
    If c_e is not positive, alpha negative, either not finite, or the shape unknown.

Notes
-----
The unit of c_e follows from F = c_e R^2 (h/R)^{3/2}; per millisecond is the only reading of the paper's alpha
that gives millimetres in seconds. Both are our decisions: the paper prints no units.

Examples
--------
>>> import burrlab
>>> burrlab.Material("test block", c_e=2.0, alpha=0.1)
Material('test block', c_e=2.0, alpha=0.1, shape='parabolic', source='')
)")
      .def(py::init(
               [](const py::str& name, double c_e, double alpha, const ShapeArgument& shape,
                  const py::str& source) { return Material(name, c_e, alpha, to_shape(shape), source); }),
           py::arg("name"), py::kw_only(), py::arg("c_e"), py::arg("alpha"), py::arg("shape") = "parabolic",
           py::arg("source") = "")
      .def_readonly("name", &Material::name)
      .def_readonly("c_e", &Material::c_e, "Elastic constant [N/mm^2]")
      .def_readonly("alpha", &Material::alpha, "Erosion rate [1/ms]")
      .def_readonly("shape", &Material::shape, "Erosion shape function")
      .def_readonly("source", &Material::source, "Where the numbers come from")
      .def(
          "__eq__", [](const Material& a, const Material& b) { return a == b; }, py::is_operator())
      .def("__hash__",
           [](const Material& a) { return py::hash(py::make_tuple(a.name, a.c_e, a.alpha, a.shape.name())); })
      .def("__repr__",
           [](const Material& a) {
             return std::string(py::str("Material({!r}, c_e={!r}, alpha={!r}, shape={!r}, source={!r})")
                                    .format(a.name, a.c_e, a.alpha, a.shape.name(), a.source));
           })
      .def(py::pickle(
          [](const Material& a) { return py::make_tuple(a.name, a.c_e, a.alpha, a.shape, a.source); },
          [](const py::tuple& t) {
            return Material(t[0].cast<std::string>(), t[1].cast<double>(), t[2].cast<double>(),
                            t[3].cast<Shape>(), t[4].cast<std::string>());
          }));
}
