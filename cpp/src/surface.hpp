// The bone's surface for drawing, in blocks of 32^3 voxels that can be replaced one by one.
#pragma once

#include <cstdint>
#include <vector>

#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// Triangles of a block. Neighbours repeat the vertices on their common border to the bit. All blocks
/// together are closed manifolds, if vertices of the same number are joined.
struct SurfaceBlock {
  std::vector<float> points;            ///< (x, y, z) each [mm], bone frame
  std::vector<float> normals;           ///< (x, y, z) each, out of the bone, length 1
  std::vector<std::int32_t> triangles;  ///< three vertices each, counter-clockwise seen from outside
  std::vector<std::uint8_t> tissues;    ///< tissue number of the nearest solid voxel; 0 without tissues
  std::vector<std::uint8_t> lost;       ///< most levels lost by one of the eight voxels around
  std::vector<std::int64_t> numbers;    ///< of the vertex in the volume
};

constexpr int surface_side = 32;  ///< voxels along an edge of a block

/// The surface where the level rises from below `level` (1..255) to at least `level`. The space outside the
/// volume is empty. Throws if there is no such block.
SurfaceBlock extract_surface(const VoxelBone& bone, const Index3& block, int level);

}  // namespace burrlab
