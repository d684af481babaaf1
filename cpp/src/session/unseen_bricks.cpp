#include "burrlab/session/unseen_bricks.hpp"

namespace burrlab {

void UnseenBricks::mark(const std::vector<std::uint32_t>& bricks) {
  for (const std::uint32_t brick : bricks) marks_[brick] = 1;
}

void UnseenBricks::take(const VoxelBone& bone, BoneUpdate& update) {
  for (std::size_t brick = 0; brick < marks_.size(); ++brick) {
    if (!marks_[brick]) continue;
    marks_[brick] = 0;
    update.bricks.push_back(std::uint32_t(brick));
    update.density.insert(update.density.end(), bone.tile(brick), bone.tile(brick) + brick_voxels);
  }
}

}  // namespace burrlab
