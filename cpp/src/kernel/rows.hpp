// The rows of a brick: their distances from the sphere's centre, and which of them a tick visits. Included
// once per instruction set, after its lanes_*.hpp; all is local to that file.
#pragma once

#include "lowest_bit.hpp"

namespace burrlab::kernel {
namespace {

constexpr int lanes = 8;        // a row of a brick
constexpr int brick_rows = 64;  // row i lies along x at y = i % 8, z = i / 8

using RowSet = std::uint64_t;  // one bit per row

inline void store(std::uint32_t* to, Integer a) { store(reinterpret_cast<std::int32_t*>(to), a); }

/// Constants of the tick, in lanes. Local to a visit, so that no store to the bone can alias them and the
/// compiler keeps them in registers.
struct Constants {
  Float zero = set(0.0f), one = set(1.0f), half = set(0.5f), two = set(2.0f), n256 = set(256.0f);
  Float least = set(0x1p-20f);  // least w: never 0, as it divides
  Float spacing, spacing_inverse, relative_spacing, radius, radius_inverse, radius2_inverse, deep2,
      fraction_scale;
  Integer p;                  // of a brick of one pristine level
  Float p_levels, p_inverse;  // 256 p, and 1/(65536 p)

  Constants(const Sphere& at, const Brick& brick)
      : spacing(set(at.spacing[0])),
        spacing_inverse(set(at.spacing_inverse)),
        relative_spacing(set(at.spacing[0] * at.radius_inverse)),
        radius(set(at.radius)),
        radius_inverse(set(at.radius_inverse)),
        radius2_inverse(set(at.radius2_inverse)),
        deep2(set(at.deep2)),
        fraction_scale(set(brick.fraction_scale)) {
    set_pristine(set(brick.level));
  }
  void set_pristine(Integer level) {
    p = level;
    p_levels = larger(to_float(level), one) * n256;  // an empty voxel would divide by zero
    p_inverse = one / (p_levels * n256);
  }
};

/// The brick's distances by row.
struct RowDistances {
  alignas(64) float r2[64];  // dz dz + dy dy
  alignas(64) float a2[64];  // likewise of spacing times offset; anisotropic voxels only
  Float x2, ax2;             // as r2 and a2, along a row
  float x2_least, x2_most;
};

template <bool isotropic>
inline void measure_distances(const Sphere& at, const Brick& brick, RowDistances& distances) {
  const auto offset = [&](int first, int axis) {
    return (to_float(set(first) + index_in_row()) - set(at.fraction[axis])) * set(at.spacing[axis]);
  };
  const Float dx = offset(brick.x, 0), dy = offset(brick.y, 1), dz = offset(brick.z, 2);
  alignas(64) float x2[lanes], z2[lanes];
  distances.x2 = dx * dx;
  store(x2, distances.x2);
  store(z2, dz * dz);
  const bool beside = brick.x > 0 || brick.x < -7;
  distances.x2_most = x2[0] > x2[7] ? x2[0] : x2[7];
  distances.x2_least = !beside ? 0.0f : x2[0] < x2[7] ? x2[0] : x2[7];
  const Float y2 = dy * dy;
  for (int z = 0; z < 8; ++z) store(distances.r2 + 8 * z, set(z2[z]) + y2);
  if (!isotropic) {
    const Float ax = set(at.spacing[0]) * dx, ay = set(at.spacing[1]) * dy, az = set(at.spacing[2]) * dz;
    distances.ax2 = ax * ax;
    store(z2, az * az);
    const Float ay2 = ay * ay;
    for (int z = 0; z < 8; ++z) store(distances.a2 + 8 * z, set(z2[z]) + ay2);
  }
}

/// The rows that hold bone within the sphere's reach: `shallow` ones meet its boundary, `deep` ones lie
/// wholly 3.5 voxels or more below it.
struct RowsToVisit {
  RowSet shallow, deep;
};

inline RowsToVisit rows_to_visit(const Sphere& at, const Brick& brick, const RowDistances& distances) {
  const Float reach2 = set(at.outer2 - distances.x2_least), deep2 = set(at.deep2),
              most = set(distances.x2_most);
  RowSet held = 0, reached = 0, deep = 0;
  for (int z = 7; z >= 0; --z) {
    const Float r2 = load(distances.r2 + 8 * z);
    held = held << 8 | rows_that_hold(brick.density + 64 * z);
    reached = reached << 8 | bits(r2 <= reach2);
    deep = deep << 8 | bits(r2 + most <= deep2);
  }
  return {held & reached & ~deep, held & reached & deep};
}

inline Float squared_distance(const float* by_row, Float x2, unsigned row) { return set(by_row[row]) + x2; }

}  // namespace
}  // namespace burrlab::kernel
