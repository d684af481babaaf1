// Poses between OpenIGTLink's frame, RAS [mm], and the bone's, LPS [mm]: x and y change sign, of the tool's
// own axes too.
#pragma once

#include <algorithm>
#include <limits>

#include "burrlab/types.hpp"
#include "network/openigtlink.hpp"
#include "quaternion.hpp"

namespace burrlab::openigtlink {

/// A rotation in the other frame.
inline RotationRows turned(const RotationRows& rotation) {
  RotationRows other;
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 3; ++column)
      other(row, column) = (row == 2) == (column == 2) ? rotation(row, column) : 0.0 - rotation(row, column);
  return other;
}

/// A position and an orientation (w, x, y, z) in the bone frame as a TRANSFORM, rounded to a finite float32.
inline Transform to_ras(const Vec3& position, const Quaternion& q = {1.0, 0.0, 0.0, 0.0}) {
  Transform transform;
  const RotationRows rotation = turned(to_eigen(q).toRotationMatrix());
  std::copy_n(rotation.data(), 9, transform.rotation.begin());
  constexpr double most = std::numeric_limits<float>::max();
  for (int axis = 0; axis < 3; ++axis) {
    const double value = std::clamp(position[axis], -most, most);
    transform.position[axis] = float(axis < 2 ? 0.0 - value : value);  // no -0
  }
  return transform;
}

/// Position of a TRANSFORM in the bone frame: exactly the float32 numbers sent.
inline Vec3 position_from_ras(const Transform& transform) {
  const auto& p = transform.position;
  return {0.0 - double(p[0]), 0.0 - double(p[1]), double(p[2])};
}

/// Whether a tick can use the position: it is within 1 km of the origin (our choice).
inline bool is_plausible(const Vec3& position) { return (position.array().abs() <= 1e6).all(); }

}  // namespace burrlab::openigtlink
