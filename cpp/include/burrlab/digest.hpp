// The digest of a bone, updated from the bricks that changed.
//
//     burrlab::RunningDigest digest(*bone);
//     contact.step({0, 0, 2.7}, 1.0, true);
//     digest.update(*bone, bone->take_changed());
//     const bool same = digest.total().text() == bone->digest();
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// 128 bits that are summed over bricks.
struct BURRLAB_API Hash128 {
  std::uint64_t a = 0;  ///< lower half
  std::uint64_t b = 0;  ///< upper half

  void add(const Hash128& other);       ///< 128-bit sum
  void subtract(const Hash128& other);  ///< 128-bit difference
  std::string text() const;             ///< 32 hexadecimal digits
  bool operator==(const Hash128& o) const { return a == o.a && b == o.b; }
  bool operator!=(const Hash128& o) const { return !(*this == o); }
};

/// `VoxelBone::digest()`, updated with the bricks that changed.
class BURRLAB_API RunningDigest {
 public:
  /// Of all bricks. As in `update`, the caller holds a VoxelBone::Reading if others could change the bone.
  explicit RunningDigest(const VoxelBone& bone);

  /// With the bricks that changed since, by number.
  void update(const VoxelBone& bone, const std::vector<std::uint32_t>& changed);
  const Hash128& brick(std::size_t number) const { return brick_[number]; }  ///< its part of the sum
  const Hash128& total() const { return total_; }                            ///< of the bone

 private:
  std::vector<Hash128> brick_;
  Hash128 total_;
};

}  // namespace burrlab
