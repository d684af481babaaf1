#include "bindings.hpp"
#include "burrlab/check.hpp"
#include "burrlab/mean_field.hpp"

namespace py = pybind11;
using burrlab::Shape;

namespace {

using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;

std::vector<double> to_vector(const std::string& name, const Array& values) {
  if (values.ndim() != 1) burrlab::refuse("dimensions of " + name, "1", static_cast<double>(values.ndim()));
  return {values.data(), values.data() + values.size()};
}

Array to_array(const std::vector<double>& values) {
  return Array(static_cast<py::ssize_t>(values.size()), values.data());
}

}  // namespace

void bind_mean_field(py::module_& m) {
  m.def(
      "mean_field_descent",
      [](const Shape& shape, double phi, double stop, double resolution) {
        burrlab::MeanFieldDescent descent;
        {
          const py::gil_scoped_release release;
          descent = burrlab::mean_field_descent(shape, phi, stop, resolution);
        }
        return py::make_tuple(to_array(descent.time), to_array(descent.immersion));
      },
      py::arg("shape"), py::arg("phi"), py::arg("stop"), py::arg("resolution") = 1.0,
      "Descent at the constant force phi = F/(c_e R^2): (time [1/alpha], immersion [R]), copies, both (n,).");
  m.def(
      "thin_layer_velocity",
      [](const Shape& shape, const Array& phi, const Array& immersion) {
        return py::vectorize([&shape](double force, double depth) {
          return burrlab::thin_layer_velocity(shape, force, depth);
        })(phi, immersion);
      },
      py::arg("shape"), py::arg("phi"), py::arg("immersion"),
      "Thin-layer velocity [alpha R] at an immersion [R]; arguments broadcast.");
  m.def(
      "window_velocity",
      [](const Array& time, const Array& immersion, double start, double stop) {
        const std::vector<double> t = to_vector("time", time), h = to_vector("immersion", immersion);
        const py::gil_scoped_release release;
        return burrlab::window_velocity(t, h, start, stop);
      },
      py::arg("time"), py::arg("immersion"), py::arg("start"), py::arg("stop"),
      "Least-squares slope of immersion over time between two immersions; both arrays (n,), rising.");
}
