// The digest of a bone, updated from the bricks that changed.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// 128 bits that are summed over bricks.
struct BURRLAB_API Hash128 {
  std::uint64_t a = 0, b = 0;

  void add(const Hash128& other);       ///< 128-bit sum
  void subtract(const Hash128& other);  ///< 128-bit difference
  std::string text() const;             ///< 32 hexadecimal digits
  bool operator==(const Hash128& o) const { return a == o.a && b == o.b; }
  bool operator!=(const Hash128& o) const { return !(*this == o); }
};

/// `VoxelBone::digest()`, updated with the bricks that changed.
class BURRLAB_API RunningDigest {
 public:
  explicit RunningDigest(const VoxelBone& bone);

  void update(const VoxelBone& bone, const std::vector<std::uint32_t>& changed);
  const Hash128& brick(std::size_t number) const { return brick_[number]; }
  const Hash128& total() const { return total_; }

 private:
  std::vector<Hash128> brick_;
  Hash128 total_;
};

}  // namespace burrlab
