// Casters that take real numbers only: pybind11 lets NumPy drop imaginary parts, and takes True for 1.
#pragma once

#include <pybind11/eigen.h>
#include <pybind11/numpy.h>

namespace pybind11::detail {

/// Whether a number is real; NumPy's kind 'c' is complex, 'b' bool.
inline bool is_real(handle number) {
  PyObject* it = number.ptr();
  if (!it || PyBool_Check(it) || PyComplex_Check(it)) return false;
  if (PyFloat_Check(it) || PyLong_Check(it) || !hasattr(number, "dtype")) return true;
  const char kind = number.attr("dtype").cast<dtype>().kind();
  return kind != 'c' && kind != 'b';
}

/// As array::ensure; but an exception that is not about the value, such as that of Ctrl-C, goes on.
inline array array_of(handle values) {
  try {
    return array(reinterpret_borrow<object>(values));
  } catch (const error_already_set& error) {
    if (!error.matches(PyExc_Exception)) throw;
    return reinterpret_steal<array>(handle());
  }
}

inline bool is_no_real(const array& values) { return !values || values.dtype().kind() == 'c'; }

template <>
inline bool type_caster<double>::load(handle src, bool convert) {
  if (!is_real(src) || !(convert || PyFloat_Check(src.ptr()) || PyLong_Check(src.ptr()))) return false;
  value = PyFloat_AsDouble(src.ptr());
  if (value != -1.0 || !PyErr_Occurred()) return true;
  if (!PyErr_ExceptionMatches(PyExc_Exception)) throw error_already_set();
  PyErr_Clear();
  return false;
}

using Reals = array_t<double, array::c_style | array::forcecast>;
template <>
inline bool pyobject_caster<Reals>::load(handle src, bool convert) {
  if ((!convert && !Reals::check_(src)) || is_no_real(array_of(src))) return false;
  value = Reals::ensure(src);
  return bool(value);
}

template <>
inline bool type_caster<Eigen::Vector3d>::load(handle src, bool convert) {
  if (!convert && !isinstance<array_t<double>>(src)) return false;
  const array given = array_of(src);
  if (is_no_real(given) || given.size() != 3 || given.shape(0) != 3 || given.ndim() > 2) return false;
  const Reals numbers = Reals::ensure(given);
  if (numbers) value = Eigen::Map<const Eigen::Vector3d>(numbers.data());
  return bool(numbers);
}

}  // namespace pybind11::detail
