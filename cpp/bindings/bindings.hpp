// Shared by the bindings. Each file has a bind_<concept>; module.cpp calls them in order of dependence.
#pragma once

#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstring>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "anatomy/anatomy_watch.hpp"
#include "burrlab/shape.hpp"
#include "real_numbers.hpp"
#include "require.hpp"
#include "session/follower.hpp"

namespace py = pybind11;
using namespace py::literals;
using namespace burrlab;

using Reals = py::detail::Reals;
using Numbers = py::array_t<std::uint32_t, py::array::c_style>;  // of bricks
using LevelArray = py::array_t<std::uint8_t, py::array::c_style>;
using Places = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>;
using Tools = std::vector<std::pair<Burr, Material>>;

/// Releases the GIL during a call.
inline const py::call_guard<py::gil_scoped_release> no_gil;

/// What a property, or a method without arguments, calls: of one type, as pybind11 compiles the call of each
/// type anew, which takes most of the time.
using Getter = std::function<py::object(const py::object&)>;

template <class T, class Get>
Getter to_getter(Get get) {
  return [get](const py::object& self) -> py::object {
    T& object = self.cast<T&>();
    using Value = std::invoke_result_t<const Get&, T&>;
    if constexpr (std::is_void_v<Value>)
      return std::invoke(get, object), py::none();
    else if constexpr (std::is_base_of_v<py::object, Value>)
      return std::invoke(get, object);
    else if constexpr (!std::is_copy_constructible_v<std::decay_t<Value>>)  // a part of the object
      return py::cast(std::invoke(get, object), py::return_value_policy::reference_internal, self);
    else
      return py::cast(std::decay_t<Value>(std::invoke(get, object)));  // a copy
  };
}

/// pybind11's class_ with such getters.
template <class T, class... Options>
struct Class : py::class_<T, Options...> {
  using Base = py::class_<T, Options...>;
  using Base::Base;

  template <class... Arguments>
  Class& def(Arguments&&... arguments) {
    Base::def(std::forward<Arguments>(arguments)...);
    return *this;
  }
  template <class Function, class = std::enable_if_t<std::is_invocable_v<Function, T&>>>
  Class& def(const char* name, Function function, const char* doc = "") {
    Base::def(name, to_getter<T>(function), doc);
    return *this;
  }
  template <class... Arguments>
  Class& def_static(Arguments&&... arguments) {
    Base::def_static(std::forward<Arguments>(arguments)...);
    return *this;
  }
  template <class Get>
  Class& def_readonly(const char* name, Get get, const char* doc = "") {
    Base::def_property_readonly(name, to_getter<T>(get), doc);
    return *this;
  }
};

/// The button that switches a burr on, -1 for none.
inline int button_of(std::optional<int> on_button) {
  if (on_button && *on_button < 0) refuse("on_button", "0 to 7, or None", *on_button);
  return on_button.value_or(-1);
}

/// Runs `work` without the GIL; returns its result.
template <class Work>
auto without_gil(Work&& work) {
  const py::gil_scoped_release release;
  return work();
}

/// A copy of `count` values in an array of this shape.
template <class Value>
py::array_t<Value> to_array(const Value* values, std::vector<py::ssize_t> shape) {
  py::array_t<Value> out(std::move(shape));
  if (out.size()) std::memcpy(static_cast<void*>(out.mutable_data()), values, std::size_t(out.nbytes()));
  return out;
}
template <class Value>
py::array_t<Value> to_array(const std::vector<Value>& values) {
  return to_array(values.data(), {py::ssize_t(values.size())});
}

/// Python's str.format.
template <class... Values>
std::string format(const char* text, Values&&... values) {
  return py::str(text).format(std::forward<Values>(values)...);
}

/// An argument whose type is checked here: TypeError in one sentence with its name, the rule and the value.
template <class Value>
Value argument(const char* name, const char* rule, const py::object& object) {
  py::detail::make_caster<Value> caster;
  if (caster.load(object, true)) return py::detail::cast_op<Value>(std::move(caster));
  const py::object shown = py::module_::import("burrlab.common.check").attr("shown")(object);
  throw py::type_error(format("{} must be {}, got {}", name, rule, shown));
}

inline Vec3 to_point(const char* name, const py::object& object) {
  return argument<Vec3>(name, "three numbers (x, y, z) [mm]", object);
}

/// Python's UserWarning at the caller's line; none where a module of burrlab calls, but its command line.
inline void warn(const std::string& text) {
  const py::dict globals = py::globals();
  const std::string caller = globals.contains("__name__") ? py::str(globals["__name__"]) : py::str();
  if (caller.rfind("burrlab.", 0) == 0 && caller.rfind("burrlab.cli", 0) != 0) return;
  if (PyErr_WarnEx(PyExc_UserWarning, text.c_str(), 1) != 0) throw py::error_already_set();
}

/// Three values, as of a Vec3, an Index3 or a colour.
template <class Values>
py::tuple three(const Values& values) {
  return py::make_tuple(values[0], values[1], values[2]);
}

inline Index3 shape_of(const py::array& values) {
  return {values.shape(0), values.shape(1), values.shape(2)};
}

/// Text from a peer, which may not be UTF-8.
inline py::str to_text(std::string_view bytes) {
  PyObject* text = PyUnicode_DecodeUTF8(bytes.data(), py::ssize_t(bytes.size()), "replace");
  if (!text) throw py::error_already_set();
  return py::reinterpret_steal<py::str>(text);
}

/// A shape or its name; a wrong name gets its own error.
inline Shape to_shape(const py::object& shape) {
  using Given = std::variant<std::string, Shape>;
  const auto given = argument<Given>("shape", "a name or a Shape, such as Shape('parabolic')", shape);
  if (const auto* name = std::get_if<std::string>(&given)) return Shape::parse(*name);
  return std::get<Shape>(given);
}

/// An update of this bone: tick, newest record or None, bricks (n, 3), density (n, 8, 8, 8).
py::dict to_dict(const BoneUpdate& update, const VoxelBone& bone);

/// The events of a watch, without the first `known`, its doses and counts.
py::dict to_dict(const AnatomyWatch& watch, std::size_t known);

/// Tissue numbers of a box, (z, y, x); None without tissues.
py::object tissue_box(const VoxelBone& bone, const Index3& start, const Index3& shape);

SessionSetup to_setup(const Tools& tools, std::uint64_t seed, double period, const std::string& scheme);

/// (copy of the bone, ticks executed on it), of a Follower or a Replica.
template <class Following>
py::tuple snapshot_of(const Following& following) {
  std::uint64_t tick = 0;
  const auto bone = without_gil([&] { return following.snapshot(tick); });
  return py::make_tuple(bone, tick);
}

/// As `to_dict` of the watch of a Follower or a Replica.
template <class Following>
py::dict watched_by(const Following& following, std::size_t known) {
  const auto copy = without_gil([&] {
    return following.visit([](FollowedBone& followed) {
      const auto& watch = followed.executor().watch();
      return watch ? std::make_optional(*watch) : std::nullopt;
    });
  });
  if (!copy) throw std::invalid_argument("watch must be set first");
  return to_dict(*copy, known);
}

void bind_material(py::module_& m);
void bind_tissues(py::module_& m);
void bind_voxel_bone(py::module_& m);
void bind_force(py::module_& m);
void bind_burr_contact(py::module_& m);
void bind_force_controller(py::module_& m);
void bind_mean_field(py::module_& m);
void bind_anatomy(py::module_& m);
void bind_session(py::module_& m);
void bind_device(py::module_& m);
void bind_follower(py::module_& m);
void bind_network_devices(py::module_& m);
void bind_network(py::module_& m);
void bind_effect_parameters(py::module_& m);
void bind_effects(py::module_& m);
void bind_surface(py::module_& m);
