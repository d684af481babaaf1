// Which tissue each voxel of a bone is: one number a voxel, or one a brick where it is the same throughout.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "burrlab/brick.hpp"
#include "burrlab/tissues.hpp"
#include "burrlab/types.hpp"

namespace burrlab {

/// Never changes once it is made, so that copies of a bone share it.
class TissueMap {
 public:
  using Sums = std::array<std::int64_t, Tissues::most>;  ///< by tissue

  /// Numbers (z, y, x) into the table; throws where one is not in it.
  TissueMap(const Index3& shape, const std::uint8_t* numbers, const Tissues& table);

  const Tissues& table() const { return table_; }
  const Index3& shape() const { return shape_; }
  /// Dense copy of a box, (z, y, x); it must lie inside.
  void read(const Index3& start, const Index3& shape, std::uint8_t* out) const;

  // Bricks by number, as in VoxelBone.
  /// 512 numbers (z, y, x), aligned to a cache line; null where they are all `number(brick)`.
  const std::uint8_t* tile(std::size_t brick) const { return mixed(brick) ? tiles_.tile(brick) : nullptr; }
  std::uint8_t number(std::size_t brick) const { return number_[brick]; }  ///< of its first voxel
  /// Bit i: tissue i is in it.
  std::uint64_t present(std::size_t brick) const { return present_[brick]; }
  /// Adds sign times the levels of a mixed brick, aligned to a cache line, to the sums of its tissues.
  void add(std::size_t brick, const std::uint8_t* levels, int sign, Sums& sums) const;

  std::size_t hierarchy_bytes() const { return number_.size() * (sizeof number_[0] + sizeof present_[0]); }

 private:
  bool mixed(std::size_t brick) const { return (present_[brick] & (present_[brick] - 1)) != 0; }

  Index3 shape_, bricks_;
  Tissues table_;
  std::vector<std::uint8_t> number_;
  std::vector<std::uint64_t> present_;
  Tiles tiles_;  // only where a brick is mixed; beyond the volume the number of the brick's first voxel
};

}  // namespace burrlab
