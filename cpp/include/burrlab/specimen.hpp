// Blocks of solid bone to try a burr on.
//
//     const burrlab::Burr burr(3.0);
//     auto bone = std::make_shared<burrlab::VoxelBone>(burrlab::half_space(burr, 0.1, 1.0));
#pragma once

#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// Bone of one level (255: solid) in the box between two corners (x, y, z) [mm], which grows to whole voxels
/// of `spacing` [mm]. Voxel faces lie at multiples of the spacing. Throws if a side is not positive.
BURRLAB_API VoxelBone block(const Vec3& low, const Vec3& high, double spacing, std::uint8_t level = 255);

/// Solid bone below the plane z = 0, as large as a descent along -z through the origin needs until the burr's
/// tip is `depth` [mm] deep: the same bone as half_space of the Python package. Throws unless depth and
/// spacing are positive.
BURRLAB_API VoxelBone half_space(const Burr& burr, double spacing, double depth);

}  // namespace burrlab
