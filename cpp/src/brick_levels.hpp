// The levels of bricks: the sums of one, and many in few bytes.
#pragma once

#include <algorithm>

#include "burrlab/brick.hpp"

namespace burrlab {

/// Calls visit(place, number) for every brick that a box of voxels meets.
template <class Visit>
void each_brick(const Index3& bricks, const Index3& start, const Index3& shape, Visit visit) {
  if (product(shape) == 0) return;
  Index3 first, last;
  for (int axis = 0; axis < 3; ++axis) {
    first[axis] = start[axis] / brick_side;
    last[axis] = (start[axis] + shape[axis] - 1) / brick_side;
  }
  each_place(first, last, [&](const Index3& at) { visit(at, number_in(bricks, at)); });
}

/// Calls visit(offset in the tile, offset in the box, length) for every row of a box within a brick.
template <class Visit>
void each_row(const Index3& at, const Index3& start, const Index3& shape, Visit visit) {
  Index3 low, high;
  for (int axis = 0; axis < 3; ++axis) {
    low[axis] = std::max(start[axis], at[axis] * brick_side);
    high[axis] = std::min(start[axis] + shape[axis], (at[axis] + 1) * brick_side);
  }
  for (std::int64_t z = low[0]; z < high[0]; ++z)
    for (std::int64_t y = low[1]; y < high[1]; ++y)
      visit(((z & 7) * brick_side + (y & 7)) * brick_side + (low[2] & 7),
            ((z - start[0]) * shape[1] + y - start[1]) * shape[2] + low[2] - start[2],
            std::size_t(high[2] - low[2]));
}

/// The sums of a tile: levels (z, y, x), aligned to a cache line.
BrickSums sum_brick(const std::uint8_t* tile);

/// Bricks in few bytes: the level of each, whether it has a tile, and these tiles.
std::vector<std::uint8_t> pack(const std::vector<std::uint8_t>& level,
                               const std::vector<const std::uint8_t*>& tile);
/// Where each brick's tile lies among packed bytes; null for a uniform brick, whose level is packed[brick].
/// Throws unless these are the bytes of so many bricks.
std::vector<const std::uint8_t*> packed_tiles(const std::uint8_t* packed, std::size_t size,
                                              std::size_t bricks);

}  // namespace burrlab
