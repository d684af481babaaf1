// Bricks: the tiles of 8^3 voxels that hold a bone, with sums that spare a visit.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "burrlab/types.hpp"

namespace burrlab {

constexpr int brick_side = 8;      ///< voxels along an edge
constexpr int brick_voxels = 512;  ///< voxels, and bytes, of a tile; a z-slab is one cache line

/// Elements of a grid.
inline std::int64_t product(const Index3& n) { return n[0] * n[1] * n[2]; }

/// How many blocks of this side cover a grid of n.
inline Index3 covering(const Index3& n, std::int64_t side) {
  return {(n[0] + side - 1) / side, (n[1] + side - 1) / side, (n[2] + side - 1) / side};
}

/// The number of a place in a grid, in C order.
inline std::size_t number_in(const Index3& grid, const Index3& at) {
  return static_cast<std::size_t>((at[0] * grid[1] + at[1]) * grid[2] + at[2]);
}
/// The place of a number in a grid.
inline Index3 place_in(const Index3& grid, std::int64_t number) {
  return {number / (grid[1] * grid[2]), number / grid[2] % grid[1], number % grid[2]};
}

/// Calls visit(place) for all from `first` to `last`, inclusive, in order.
template <class Visit>
void each_place(const Index3& first, const Index3& last, Visit visit) {
  for (std::int64_t z = first[0]; z <= last[0]; ++z)
    for (std::int64_t y = first[1]; y <= last[1]; ++y)
      for (std::int64_t x = first[2]; x <= last[2]; ++x) visit(Index3{z, y, x});
}

/// @cond tick
/// Exact sums over a brick, of q and of q times the voxel's index 0..7 in the brick.
struct BrickSums {
  std::uint32_t mass = 0, x = 0, y = 0, z = 0;
};

/// Tiles of zeros, aligned to cache lines. A page takes memory only when it is written to.
class Tiles {
 public:
  Tiles() = default;
  explicit Tiles(std::size_t bricks);
  Tiles(Tiles&&) = default;  // not copied, as copies would share the levels
  Tiles& operator=(Tiles&&) = default;
  std::uint8_t* tile(std::size_t brick) { return first_ + brick * brick_voxels; }
  const std::uint8_t* tile(std::size_t brick) const { return first_ + brick * brick_voxels; }
  bool empty() const { return first_ == nullptr; }
  /// Keeps the memory; others may be storing to it.
  std::shared_ptr<const std::uint8_t> share() const { return {memory_, first_}; }

 private:
  std::shared_ptr<void> memory_;
  std::uint8_t* first_ = nullptr;
};

/// How a BoneView finds the bricks that changed, and knows whether one that it read is whole. One thread at a
/// time calls `begin`, stores the brick's levels as atomics (kernel/shared_rows.hpp), and calls `end`.
struct BrickVersions {
  static constexpr std::size_t fan = 64;  ///< bricks of a group

  std::vector<std::atomic<std::uint32_t>> brick;  ///< twice its changes; odd while its levels are stored
  std::vector<std::atomic<std::uint64_t>> group;  ///< changes of its bricks

  explicit BrickVersions(std::size_t bricks) : brick(bricks), group((bricks + fan - 1) / fan) {}

  void begin(std::size_t number) noexcept {
    brick[number].store(brick[number].load(std::memory_order_relaxed) | 1, std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_release);
  }
  void end(std::size_t number, bool differs) noexcept {
    const std::uint32_t odd = brick[number].load(std::memory_order_relaxed);
    brick[number].store(differs ? odd + 1 : odd - 1, std::memory_order_release);
    auto& changes = group[number / fan];
    if (differs) changes.store(changes.load(std::memory_order_relaxed) + 1, std::memory_order_release);
  }
};

/// Which bricks hold bone: one bit per brick in 64-bit words of 4^3 bricks (a block), and one bit per block
/// in words of 4^3 blocks. A walk skips empty space in steps of 32 and of 128 voxels.
class Occupancy {
 public:
  static constexpr int fan = 4;  ///< children along an edge

  explicit Occupancy(const Index3& bricks);

  void set(const Index3& brick, bool occupied);

  const Index3& blocks() const { return blocks_; }  ///< number of blocks (z, y, x)
  const Index3& blocks_of_blocks() const { return superblocks_; }
  std::uint64_t block(std::int64_t z, std::int64_t y, std::int64_t x) const {
    return block_[number_in(blocks_, {z, y, x})];
  }
  std::uint64_t block_of_blocks(std::int64_t z, std::int64_t y, std::int64_t x) const {
    return superblock_[number_in(superblocks_, {z, y, x})];
  }
  /// Bit of the child at (z, y, x) in its parent's word.
  static int bit(std::int64_t z, std::int64_t y, std::int64_t x) {
    return static_cast<int>((z & 3) << 4 | (y & 3) << 2 | (x & 3));
  }
  std::size_t bytes() const { return (block_.size() + superblock_.size()) * sizeof(std::uint64_t); }

 private:
  Index3 blocks_, superblocks_;
  std::vector<std::uint64_t> block_, superblock_;
};
/// @endcond

}  // namespace burrlab
