// The levels of bricks: the sums of one, and many in few bytes.
#pragma once

#include "burrlab/brick.hpp"

namespace burrlab {

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
