// Positions between OpenIGTLink's frame, RAS [mm], and the bone's, LPS [mm]: x and y change sign.
#pragma once

#include <cmath>

#include "burrlab/network/openigtlink.hpp"
#include "burrlab/types.hpp"

namespace burrlab::openigtlink {

/// A position in the bone frame as a TRANSFORM without rotation, rounded to float32.
inline Transform to_ras(const Vec3& position) {
  Transform transform;
  for (int axis = 0; axis < 3; ++axis)
    transform.position[axis] = float(axis < 2 ? 0.0 - position[axis] : position[axis]);  // no -0
  return transform;
}

/// Position of a TRANSFORM in the bone frame: exactly the float32 numbers sent.
inline Vec3 position_from_ras(const Transform& transform) {
  const auto& p = transform.position;
  return {0.0 - double(p[0]), 0.0 - double(p[1]), double(p[2])};
}

/// Whether a tick can use the position: it is within 1 km of the origin (our choice).
inline bool is_plausible(const Vec3& position) {
  for (int axis = 0; axis < 3; ++axis)
    if (!(std::abs(position[axis]) <= 1e6)) return false;
  return true;
}

}  // namespace burrlab::openigtlink
