// Bricks: the tiles of 8^3 voxels that hold a bone, with sums that spare a visit.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <memory>
#include <vector>

#include "burrlab/types.hpp"

namespace burrlab {

constexpr int brick_side = 8;      ///< voxels along an edge
constexpr int brick_voxels = 512;  ///< voxels, and bytes, of a tile; a z-slab is one cache line

/// Exact sums over a brick, of q and of q times the voxel's index 0..7 in the brick.
struct BrickSums {
  std::uint32_t mass = 0, x = 0, y = 0, z = 0;
};

/// Tiles of zeros, aligned to cache lines. A page takes memory only when it is written to.
class Tiles {
 public:
  Tiles() = default;
  explicit Tiles(std::size_t bricks);
  std::uint8_t* tile(std::size_t brick) { return first_ + brick * brick_voxels; }
  const std::uint8_t* tile(std::size_t brick) const { return first_ + brick * brick_voxels; }
  bool empty() const { return first_ == nullptr; }

 private:
  struct Free {
    void operator()(void* memory) const { std::free(memory); }
  };
  std::unique_ptr<void, Free> memory_;
  std::uint8_t* first_ = nullptr;
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
    return block_[static_cast<std::size_t>((z * blocks_[1] + y) * blocks_[2] + x)];
  }
  std::uint64_t block_of_blocks(std::int64_t z, std::int64_t y, std::int64_t x) const {
    return superblock_[static_cast<std::size_t>((z * superblocks_[1] + y) * superblocks_[2] + x)];
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

}  // namespace burrlab
