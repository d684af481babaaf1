// What a consumer of a bone that changes has not seen yet.
#pragma once

#include <cstdint>
#include <vector>

#include "burrlab/session/tick_record.hpp"
#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// A bone's state since a consumer last asked.
struct BoneUpdate {
  std::uint64_t tick = 0;  ///< ticks executed
  TickRecord newest;
  bool any = false;                   ///< there was a tick
  std::vector<std::uint32_t> bricks;  ///< that changed since the last update
  std::vector<std::uint8_t> density;  ///< 512 levels each, (z, y, x)
};

/// A mark a brick. Whoever owns the bone sees to it that calls do not overlap.
class UnseenBricks {
 public:
  explicit UnseenBricks(std::size_t bricks) : marks_(bricks, 0) {}
  void mark(const std::vector<std::uint32_t>& bricks);
  /// Those marked, with their levels; none is marked any more.
  void take(const VoxelBone& bone, BoneUpdate& update);

 private:
  std::vector<std::uint8_t> marks_;
};

}  // namespace burrlab
