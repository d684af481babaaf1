// The walk of a tick over the bricks with bone that the sphere may touch, by the occupancy words.
#pragma once

#include <algorithm>
#include <cstdint>

#include "burrlab/brick.hpp"
#include "lowest_bit.hpp"

namespace burrlab {

/// A sphere over bricks, axes (x, y, z).
struct SphereInBricks {
  std::int64_t first[3],
      last[3];        // bricks of its box, inclusive, clipped to the volume; none where first > last
  double center[3];   // [voxel]
  double spacing[3];  // [mm]
  double outer;       // no voxel whose centre is farther is touched [mm]
  double whole;       // every voxel whose centre is nearer is covered whole [mm]
};

// Least and largest squared distance along an axis, from the centre to the voxels of four bricks in a row.
struct Reach {
  double least[4], most[4];

  Reach(std::int64_t first_brick, double center, double spacing) {  // center in voxels
    for (int i = 0; i < 4; ++i) {
      const double low = (static_cast<double>(brick_side * (first_brick + i)) - center) * spacing;
      const double high = low + (brick_side - 1) * spacing;
      least[i] = low > 0.0 ? low * low : high < 0.0 ? high * high : 0.0;
      most[i] = std::max(low * low, high * high);
    }
  }
  double least_of_all() const { return std::min(std::min(least[0], least[1]), std::min(least[2], least[3])); }
};

// Asks for the tile of a brick that is visited prefetch_brick.
inline void prefetch(const std::uint8_t* tile) {
#ifdef __GNUC__
  for (int i = 0; i < brick_voxels; i += 64) __builtin_prefetch(tile + i);
#else
  (void)tile;
#endif
}

// The bits of a word whose children are in a box of child numbers, clipped to the word's 4^3.
inline std::uint64_t children_within(const std::int64_t first[3], const std::int64_t last[3], std::int64_t z,
                                     std::int64_t y, std::int64_t x) {
  const auto span = [](std::int64_t low, std::int64_t high, std::int64_t parent) {
    const std::int64_t a = std::clamp<std::int64_t>(low - 4 * parent, 0, 4);
    const std::int64_t b = std::clamp<std::int64_t>(high + 1 - 4 * parent, 0, 4);
    return a < b ? ((1u << b) - (1u << a)) & 0xFu : 0u;
  };
  static constexpr std::uint64_t spread_y[16] = {0x0000, 0x000F, 0x00F0, 0x00FF, 0x0F00, 0x0F0F,
                                                 0x0FF0, 0x0FFF, 0xF000, 0xF00F, 0xF0F0, 0xF0FF,
                                                 0xFF00, 0xFF0F, 0xFFF0, 0xFFFF};
  static constexpr std::uint64_t spread_z[16] = {
      0x0000000000000000, 0x000000000000FFFF, 0x00000000FFFF0000, 0x00000000FFFFFFFF,
      0x0000FFFF00000000, 0x0000FFFF0000FFFF, 0x0000FFFFFFFF0000, 0x0000FFFFFFFFFFFF,
      0xFFFF000000000000, 0xFFFF00000000FFFF, 0xFFFF0000FFFF0000, 0xFFFF0000FFFFFFFF,
      0xFFFFFFFF00000000, 0xFFFFFFFF0000FFFF, 0xFFFFFFFFFFFF0000, 0xFFFFFFFFFFFFFFFF};
  return spread_z[span(first[2], last[2], z)] & spread_y[span(first[1], last[1], y)] * 0x0001000100010001u &
         span(first[0], last[0], x) * 0x1111111111111111u;
}

/// Calls visit(z, y, x, whole) for every such brick; `whole`: wholly inside the sphere. Before it, calls
/// prefetch_brick(z, y, x) for the next one.
template <class Visit, class Soon>
void walk_bricks(const Occupancy& occupancy, const SphereInBricks& sphere, Visit visit, Soon prefetch_brick) {
  const auto &first = sphere.first, &last = sphere.last;
  if (first[0] > last[0] || first[1] > last[1] || first[2] > last[2]) return;
  const double outer2 = sphere.outer * sphere.outer, whole2 = sphere.whole * sphere.whole;

  const auto in_block = [&](std::int64_t bz, std::int64_t by, std::int64_t bx) {
    std::uint64_t bricks = occupancy.block(bz, by, bx) & children_within(first, last, bz, by, bx);
    if (!bricks) return;
    const Reach x(4 * bx, sphere.center[0], sphere.spacing[0]),
        y(4 * by, sphere.center[1], sphere.spacing[1]), z(4 * bz, sphere.center[2], sphere.spacing[2]);
    if (x.least_of_all() + y.least_of_all() + z.least_of_all() > outer2) return;
    for (; bricks; bricks &= bricks - 1) {
      const int bit = int(lowest_bit(bricks)), i = bit & 3, j = bit >> 2 & 3, k = bit >> 4;
      if (const std::uint64_t later = bricks & (bricks - 1)) {
        const int next = int(lowest_bit(later));
        prefetch_brick(4 * bz + (next >> 4), 4 * by + (next >> 2 & 3), 4 * bx + (next & 3));
      }
      if (x.least[i] + y.least[j] + z.least[k] <= outer2)
        visit(4 * bz + k, 4 * by + j, 4 * bx + i, x.most[i] + y.most[j] + z.most[k] <= whole2);
    }
  };

  std::int64_t low[3], high[3];  // blocks
  for (int axis = 0; axis < 3; ++axis) low[axis] = first[axis] / 4, high[axis] = last[axis] / 4;
  for (std::int64_t z = low[2] / 4; z <= high[2] / 4; ++z) {
    for (std::int64_t y = low[1] / 4; y <= high[1] / 4; ++y) {
      for (std::int64_t x = low[0] / 4; x <= high[0] / 4; ++x) {
        std::uint64_t blocks = occupancy.block_of_blocks(z, y, x) & children_within(low, high, z, y, x);
        for (; blocks; blocks &= blocks - 1) {
          const int bit = int(lowest_bit(blocks));
          in_block(4 * z + (bit >> 4), 4 * y + (bit >> 2 & 3), 4 * x + (bit & 3));
        }
      }
    }
  }
}

}  // namespace burrlab
