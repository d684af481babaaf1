// The exact distance of a point to a structure as segmented: to the nearest of its voxels, each a box.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>

#include "burrlab/brick.hpp"
#include "burrlab/tissue_map.hpp"
#include "burrlab/types.hpp"
#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// The voxel of a structure that was nearest the last time: where the next search begins.
struct NearestVoxel {
  Index3 at{};  ///< (z, y, x)
  bool any = false;
};

/// All voxels that carry the tissue's number, whatever bone was or is in them.
class StructureSearch {
 public:
  /// Throws where the bone has no tissues, the tissue is none of them or no voxel carries it.
  StructureSearch(const VoxelBone& bone, std::size_t tissue);

  /// Distance of a point to the structure [mm], 0 inside it; infinity if that is not below `bound` [mm]. It
  /// does not depend on `nearest`, which only shortens the search.
  double distance(const Vec3& point, NearestVoxel& nearest,
                  double bound = std::numeric_limits<double>::infinity()) const noexcept;

  std::size_t tissue() const { return tissue_; }
  /// Whether the bone has these tissues on this grid.
  bool is_on(const VoxelBone& bone) const {
    return bone.tissues() == map_ && bone.spacing() == spacing_ && bone.origin() == origin_;
  }
  const std::shared_ptr<const TissueMap>& map() const { return map_; }
  const Vec3& low() const { return low_; }    ///< corner of the box around it [mm]
  const Vec3& high() const { return high_; }  ///< the opposite one [mm]

 private:
  struct Best;
  double edge(int axis, std::int64_t voxel) const {
    return origin_[axis] + (double(voxel) - 0.5) * spacing_[axis];
  }
  double gap(int axis, double point, std::int64_t first, std::int64_t last) const;
  void look_into(const Index3& brick, const Vec3& point, Best& best) const;

  std::shared_ptr<const TissueMap> map_;
  std::size_t tissue_;
  Index3 shape_, bricks_;
  Vec3 spacing_, origin_, low_, high_;
  Occupancy where_;  // bricks that hold some of it
};

}  // namespace burrlab
