// One sentence instead of pybind11's list of signatures, where arguments do not fit.
#include "bindings.hpp"

namespace {

constexpr int takes = METH_FASTCALL | METH_KEYWORDS;
using Call = PyObject* (*)(PyObject*, PyObject* const*, Py_ssize_t, PyObject*);
Call dispatch = nullptr;  // pybind11's, of every function here

/// As `dispatch`; where it finds no signature that fits, the error's text comes from Python.
PyObject* call(PyObject* record, PyObject* const* given, Py_ssize_t count, PyObject* names) {
  PyObject* result = dispatch(record, given, count, names);
  if (result || !PyErr_ExceptionMatches(PyExc_TypeError)) return result;
  py::error_already_set raised;
  try {
    const py::str text(raised.value());
    if (!text.contains(" arguments. The following argument types are supported:")) {
      raised.restore();
      return nullptr;
    }
    // A Ctrl-C during a conversion looks like a value that does not fit: pybind11 drops its exception.
    if (const auto fits = py::reinterpret_steal<py::object>(dispatch(record, given, count, names))) {
      PyErr_SetNone(PyExc_KeyboardInterrupt);
      return nullptr;
    }
    PyErr_Clear();
    py::list placed;
    for (Py_ssize_t i = 0; i < count; ++i) placed.append(py::handle(given[i]));
    py::dict named;
    for (Py_ssize_t i = 0; names && i < PyTuple_GET_SIZE(names); ++i)
      named[py::handle(PyTuple_GET_ITEM(names, i))] = py::handle(given[count + i]);
    const py::object told = py::module_::import("burrlab.common.refusal")
                                .attr("sentence")(py::handle(record), placed, named, text);
    PyErr_SetObject(PyExc_TypeError, told.ptr());
  } catch (py::error_already_set& other) {
    (other.matches(PyExc_KeyboardInterrupt) ? other : raised).restore();
  }
  return nullptr;
}

void watch(py::handle found) {
  PyObject* function = found.ptr();
  if (PyInstanceMethod_Check(function)) function = PyInstanceMethod_GET_FUNCTION(function);
  if (!function || !PyCFunction_Check(function)) return;
  PyMethodDef* const defined = reinterpret_cast<PyCFunctionObject*>(function)->m_ml;
  if (defined->ml_flags != takes) return;
  const auto meth = reinterpret_cast<Call>(reinterpret_cast<void (*)()>(defined->ml_meth));
  if (!dispatch) dispatch = meth;
  if (meth == dispatch) defined->ml_meth = reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(&call));
}

void watch_all(py::handle scope) {
  for (const auto& item : py::dict(scope.attr("__dict__"))) {
    const py::handle found = item.second;
    if (PyType_Check(found.ptr()) && hasattr(found, "__module__") &&
        py::str(found.attr("__module__")).equal(py::str("burrlab._core"))) {
      watch_all(found);
    } else if (PyObject_TypeCheck(found.ptr(), &PyProperty_Type)) {
      watch(found.attr("fset"));
    } else {
      watch(hasattr(found, "__func__") ? py::object(found.attr("__func__"))
                                       : py::reinterpret_borrow<py::object>(found));
    }
  }
}

}  // namespace

// A call costs one more jump; the rest happens after the TypeError.
void bind_refusal(py::module_& m) {
  watch(m.attr("cpu_paths"));
  watch_all(m);
}
