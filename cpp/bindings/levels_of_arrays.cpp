// Arrays of densities as levels.
#include <algorithm>
#include <cmath>
#include <sstream>
#include <type_traits>

#include "bone_bindings.hpp"
#include "burrlab/check.hpp"

namespace py = pybind11;

namespace {

std::string dtype_name(const py::array& values) { return std::string(py::str(values.dtype())); }

// Values lo..hi of any real type to levels 0..255, to nearest.
template <class T>
Levels scale(const py::array& values, double lo, double hi) {
  const auto dense = py::array_t<T, py::array::c_style>::ensure(values);
  const T* in = dense.data();
  if constexpr (std::is_same_v<T, std::uint8_t>) {
    if (lo == 0.0 && hi == 255.0) return Levels(in, in + dense.size());
  }
  constexpr bool single = std::is_same_v<T, float>;  // its values were rounded; so are its limits
  const double low = single ? static_cast<float>(lo) : lo, high = single ? static_cast<float>(hi) : hi;
  Levels out(static_cast<std::size_t>(dense.size()));
  for (std::size_t i = 0; i < out.size(); ++i) {
    const double value = static_cast<double>(in[i]);
    if (!std::isfinite(value)) burrlab::refuse("every density", "finite", value);
    if (value < low || value > high) {
      std::ostringstream rule;
      rule << "within the range " << lo << " to " << hi;
      burrlab::refuse("every density", rule.str(), value);
    }
    out[i] = static_cast<std::uint8_t>(std::rint(std::clamp((value - lo) / (hi - lo), 0.0, 1.0) * 255.0));
  }
  return out;
}

}  // namespace

Levels to_levels(const py::array& values, Range range) {
  if (values.ndim() != 3) burrlab::refuse("dimensions of density", "3 (z, y, x)", double(values.ndim()));
  const bool is_levels = py::isinstance<py::array_t<std::uint8_t>>(values);
  if (values.dtype().kind() == 'b') range = range.value_or(std::make_pair(0.0, 1.0));
  if (is_levels) range = range.value_or(std::make_pair(0.0, 255.0));
  if (!range) {
    throw std::invalid_argument("range must be given for densities of type " + dtype_name(values) +
                                ": the values of empty and of solid bone");
  }
  const auto [lo, hi] = *range;
  if (!(std::isfinite(lo) && std::isfinite(hi) && lo < hi)) {
    throw std::invalid_argument("range must be two finite values, empty below solid, got (" +
                                std::string(py::str(py::float_(lo))) + ", " +
                                std::string(py::str(py::float_(hi))) + ")");
  }
  if (values.dtype().kind() == 'b') return scale<bool>(values, lo, hi);
  if (is_levels) return scale<std::uint8_t>(values, lo, hi);
  if (py::isinstance<py::array_t<std::int8_t>>(values)) return scale<std::int8_t>(values, lo, hi);
  if (py::isinstance<py::array_t<std::int16_t>>(values)) return scale<std::int16_t>(values, lo, hi);
  if (py::isinstance<py::array_t<std::uint16_t>>(values)) return scale<std::uint16_t>(values, lo, hi);
  if (py::isinstance<py::array_t<float>>(values)) return scale<float>(values, lo, hi);
  const char kind = values.dtype().kind();
  if (kind == 'i' || kind == 'u' || kind == 'f')
    return scale<double>(values.attr("astype")("float64"), lo, hi);
  throw std::invalid_argument("density must be an array of integers or floats, got " + dtype_name(values));
}
