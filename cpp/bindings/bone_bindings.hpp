// What the files that bind VoxelBone share.
#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "bindings.hpp"
#include "burrlab/voxel_bone.hpp"

using VoxelBoneClass = pybind11::class_<burrlab::VoxelBone, std::shared_ptr<burrlab::VoxelBone>>;
using Levels = std::vector<std::uint8_t>;
using Range = std::optional<std::pair<double, double>>;  // the values of empty and of solid bone

/// Values (z, y, x) of any type as levels; throws unless they are finite and within the range.
Levels to_levels(const pybind11::array& values, Range range);

inline burrlab::Index3 shape_of(const pybind11::array& values) {
  return {values.shape(0), values.shape(1), values.shape(2)};
}

/// Numbers (z, y, x) into a table, as a map of the bone's shape.
std::shared_ptr<const burrlab::TissueMap> to_map(const burrlab::VoxelBone& bone,
                                                 const burrlab::Tissues& tissues,
                                                 const pybind11::array& numbers);

void bind_voxel_bone_copies(VoxelBoneClass& bone);
void bind_voxel_bone_tissues(VoxelBoneClass& bone);
