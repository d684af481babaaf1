#include "bindings.hpp"
#include "burrlab/mean_field.hpp"

static std::vector<double> to_vector(const std::string& name, const Reals& values) {
  if (values.ndim() != 1) refuse("dimensions of " + name, "1", static_cast<double>(values.ndim()));
  return {values.data(), values.data() + values.size()};
}

void bind_mean_field(py::module_& m) {
  m.def(
      "mean_field_descent",
      [](const Shape& shape, double phi, double stop, double resolution) {
        const MeanFieldDescent descent =
            without_gil([&] { return mean_field_descent(shape, phi, stop, resolution); });
        return py::make_tuple(to_array(descent.time), to_array(descent.immersion));
      },
      "shape"_a, "phi"_a, "stop"_a, "resolution"_a = 1.0,
      "Descent at the constant force phi = F/(c_e R^2): (time [1/alpha], immersion [R]), copies, both (n,).");
  m.def(
      "thin_layer_velocity",
      [](const Shape& shape, const Reals& phi, const Reals& immersion) {
        return py::vectorize([&shape](double force, double depth) {
          return thin_layer_velocity(shape, force, depth);
        })(phi, immersion);
      },
      "shape"_a, "phi"_a, "immersion"_a,
      "Thin-layer velocity [alpha R] at an immersion [R]; arguments broadcast.");
  m.def(
      "window_velocity",
      [](const Reals& time, const Reals& immersion, double start, double stop) {
        const std::vector<double> t = to_vector("time", time), h = to_vector("immersion", immersion);
        return without_gil([&] { return window_velocity(t, h, start, stop); });
      },
      "time"_a, "immersion"_a, "start"_a, "stop"_a,
      "Least-squares slope of immersion over time between two immersions; both arrays (n,), rising.");
}
