// Vectors of the bone frame (voxel axes, mm).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "burrlab/error.hpp"

namespace burrlab {

using Vec3 = Eigen::Vector3d;                ///< (x, y, z)
using Index3 = std::array<std::int64_t, 3>;  ///< (z, y, x), as arrays are indexed
using Quaternion = std::array<double, 4>;    ///< (w, x, y, z)

constexpr double pi = 3.14159265358979323846;  ///< of a circle

/// The same numbers.
inline Vec3 to_vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

}  // namespace burrlab
