// Vectors of the bone frame (voxel axes, mm).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

namespace burrlab {

using Vec3 = Eigen::Vector3d;                ///< (x, y, z)
using Index3 = std::array<std::int64_t, 3>;  ///< (z, y, x), as arrays are indexed

}  // namespace burrlab
