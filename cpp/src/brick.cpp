#include "brick_levels.hpp"

#include <algorithm>
#include <cstdlib>
#include <new>

#include "kernel/kernel.hpp"

namespace burrlab {

// Sets or clears a bit; returns whether its word is not empty afterwards.
static bool change(std::uint64_t& word, int bit, bool on) {
  const std::uint64_t mask = std::uint64_t{1} << bit;
  word = on ? word | mask : word & ~mask;
  return word != 0;
}

Tiles::Tiles(std::size_t bricks)
    : memory_(std::calloc(bricks * brick_voxels + 63, 1), std::free),
      first_(reinterpret_cast<std::uint8_t*>((reinterpret_cast<std::uintptr_t>(memory_.get()) + 63) &
                                             ~std::uintptr_t{63})) {
  if (!memory_) throw std::bad_alloc();
}

BrickSums sum_brick(const std::uint8_t* tile) {
  kernel::Sums sums;
  kernel::current_kernel().sum(tile, sums);
  return {sums.after_mass, sums.after_x, sums.after_y, sums.after_z};
}

std::vector<std::uint8_t> pack(const std::vector<std::uint8_t>& level,
                               const std::vector<const std::uint8_t*>& tile) {
  const auto tiles =
      static_cast<std::size_t>(std::count_if(tile.begin(), tile.end(), [](auto t) { return t; }));
  std::vector<std::uint8_t> packed(level);
  packed.reserve(2 * level.size() + tiles * brick_voxels);
  for (const std::uint8_t* one : tile) packed.push_back(one != nullptr);
  for (const std::uint8_t* one : tile)
    if (one) packed.insert(packed.end(), one, one + brick_voxels);
  return packed;
}

std::vector<const std::uint8_t*> packed_tiles(const std::uint8_t* packed, std::size_t size,
                                              std::size_t bricks) {
  std::vector<const std::uint8_t*> tiles(bricks);
  std::size_t end = 2 * bricks;
  for (std::size_t brick = 0; brick < bricks && end <= size; ++brick) {
    if (!packed[bricks + brick]) continue;
    tiles[brick] = packed + end;
    end += brick_voxels;
  }
  if (end != size) throw InvalidArgument("packed bricks must fill the shape");
  return tiles;
}

Occupancy::Occupancy(const Index3& bricks)
    : blocks_(covering(bricks, fan)),
      superblocks_(covering(blocks_, fan)),
      block_(std::size_t(product(blocks_))),
      superblock_(std::size_t(product(superblocks_))) {}

void Occupancy::set(const Index3& brick, bool occupied) {
  const Index3 b{brick[0] / fan, brick[1] / fan, brick[2] / fan};
  const Index3 s{b[0] / fan, b[1] / fan, b[2] / fan};
  auto& block = block_[number_in(blocks_, b)];
  auto& superblock = superblock_[number_in(superblocks_, s)];
  change(superblock, bit(b[0], b[1], b[2]), change(block, bit(brick[0], brick[1], brick[2]), occupied));
}

}  // namespace burrlab
