// One bind_<concept> function a file; module.cpp calls them in order of dependence.
#pragma once

#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <string>
#include <variant>

#include "burrlab/session/follower.hpp"
#include "burrlab/shape.hpp"
#include "real_arguments.hpp"

/// A shape or its name, so that a wrong name ends in its own sentence.
using ShapeArgument = std::variant<std::string, burrlab::Shape>;
inline burrlab::Shape to_shape(const ShapeArgument& shape) {
  if (const auto* name = std::get_if<std::string>(&shape)) return burrlab::Shape::parse(*name);
  return std::get<burrlab::Shape>(shape);
}

/// tick, newest, bricks and density of what a consumer has not seen yet.
pybind11::dict to_dict(const burrlab::BoneUpdate& update, const burrlab::VoxelBone& bone);

/// What a watch has seen; events but for the first `known`.
pybind11::dict to_dict(const burrlab::AnatomyWatch& watch, std::size_t known);

/// (copy of the bone, ticks it has seen) of whatever follows a session.
template <class Following>
pybind11::tuple snapshot_of(const Following& following) {
  std::uint64_t tick = 0;
  std::shared_ptr<burrlab::VoxelBone> bone;
  {
    const pybind11::gil_scoped_release release;
    bone = following.snapshot(tick);
  }
  return pybind11::make_tuple(bone, tick);
}

/// What the watch of whatever follows a session has seen; events but for the first `known`.
template <class Following>
pybind11::dict watched_by(Following& following, std::size_t known) {
  std::shared_ptr<burrlab::AnatomyWatch> copy;
  {
    const pybind11::gil_scoped_release release;
    following.visit([&](burrlab::FollowedBone& followed) {
      if (const auto& watch = followed.executor().watch())
        copy = std::make_shared<burrlab::AnatomyWatch>(*watch);
    });
  }
  if (!copy) throw std::invalid_argument("watch must be set first");
  return to_dict(*copy, known);
}

void bind_shape(pybind11::module_& m);
void bind_material(pybind11::module_& m);
void bind_tissues(pybind11::module_& m);
void bind_voxel_bone(pybind11::module_& m);
void bind_bricks(pybind11::module_& m);
void bind_force(pybind11::module_& m);
void bind_contact(pybind11::module_& m);
void bind_burr_contact(pybind11::module_& m);
void bind_force_controller(pybind11::module_& m);
void bind_mean_field(pybind11::module_& m);
void bind_anatomy(pybind11::module_& m);
void bind_session(pybind11::module_& m);
void bind_haptic_loop(pybind11::module_& m);
void bind_follower(pybind11::module_& m);
void bind_device(pybind11::module_& m);
void bind_stability(pybind11::module_& m);
void bind_openigtlink(pybind11::module_& m);
void bind_transform_reader(pybind11::module_& m);
void bind_network(pybind11::module_& m);
void bind_effect_parameters(pybind11::module_& m);
void bind_effects(pybind11::module_& m);
void bind_surface(pybind11::module_& m);
