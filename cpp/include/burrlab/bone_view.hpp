// The changes of a bone, for a renderer beside the loop that drills it:
//
//   BoneView view(*bone);  // in any thread, also while the loop runs
//   BoneView::Changes changes;
//   for (;; sleep(50)) {
//     view.update(changes);
//     for (std::size_t i = 0; i < changes.bricks.size(); ++i)
//       draw(changes.places[i], changes.levels.data() + i * brick_voxels);
//   }
#pragma once

#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// What changed in a bone since the last call. A bone has any number of views, each used by one thread at a
/// time; a copy of a view goes on from the same call. They need no VoxelBone::Use: no step or write waits or
/// fails for a view, and no view waits for them. A view may outlive its bone; once that is assigned to, the
/// view stays at the bone before. Memory: 0.133 byte a voxel.
class BURRLAB_API BoneView {
 public:
  static constexpr int solid_level = 128;  ///< least level of a solid voxel

  /// What `update` finds.
  struct Changes {
    std::vector<std::uint32_t> bricks;  ///< numbers as in VoxelBone::place and extent, in order
    std::vector<Index3> places;         ///< first voxel of each, (z, y, x)
    std::vector<std::uint8_t> levels;   ///< present levels, 512 a brick, (z, y, x); zeros beyond the volume
    std::vector<Index3> opened;  ///< voxels (z, y, x) now below 128 that were at least 128 in the last call
    std::vector<Index3> filled;  ///< voxels now at least 128 that were below it, as after a reset
  };

  /// Not while the bone itself is being moved or assigned to.
  explicit BoneView(const VoxelBone& bone);

  /// Sets `changes` to the bricks that changed since the last call, once each with their newest levels: a
  /// slow caller misses states between, but no change. The first call gives every brick that holds bone, none
  /// of its voxels in `opened` or `filled`; drop `changes` after it to free up to 2 bytes a voxel. A brick is
  /// of one moment; two may be of different ticks. A brick that is being written in each of 16 tries comes
  /// with a later call. Allocates only to grow the vectors.
  void update(Changes& changes);
  /// The next call begins with the bone as it is now: for a renderer that has it already.
  void skip() { read_all(nullptr); }
  bool shows(const VoxelBone& bone) const { return versions_ == bone.versions_; }  ///< a view of this bone

 private:
  void read_all(Changes* changes);
  bool read(std::size_t brick, Changes* changes);

  Index3 bricks_;
  std::shared_ptr<const std::uint8_t> tiles_;
  std::shared_ptr<const BrickVersions> versions_;
  std::vector<std::uint32_t> seen_;        // version of each brick; odd before the first reading
  std::vector<std::uint64_t> seen_group_;  // changes of each group, if all its bricks were read
  std::vector<std::uint8_t> solid_;        // a bit for each voxel
};

}  // namespace burrlab
