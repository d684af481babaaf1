// The bone as parcels meet it: an own copy of its levels, what a segment through it hits, and what was lost
// since.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// Where a segment meets solid bone.
struct LevelHit {
  double part = 0.0;         ///< of the segment before it, 0..1
  Index3 voxel{};            ///< (z, y, x) that is met
  Vec3 face = Vec3::Zero();  ///< normal of the face that is met, against the segment
};

/// What a brick lost by an exchange of its levels.
struct BrickLoss {
  std::int64_t lost = 0;      ///< [levels]
  std::int64_t refilled = 0;  ///< levels that rose, as when a replay goes back
  std::array<std::uint8_t, brick_voxels> by_voxel;
};

class LevelField {
 public:
  /// Voxels from `solid_level` on are solid.
  LevelField(const VoxelBone& bone, int solid_level);

  /// New levels of a brick, and what it lost.
  BrickLoss exchange(std::size_t brick, const std::uint8_t* density);

  std::size_t brick_count() const { return solid_.size(); }
  const Index3& bricks() const { return bricks_; }  ///< (z, y, x)
  const std::shared_ptr<const TissueMap>& tissues() const { return tissues_; }
  double quantum() const { return spacing_.prod() / 255.0; }  ///< one level of one voxel [mm^3]
  const Vec3& low() const { return low_; }                    ///< corner of the volume [mm]
  const Vec3& high() const { return high_; }                  ///< the opposite one [mm]
  double least_spacing() const { return spacing_.minCoeff(); }

  /// Level of a voxel; 0 beyond the volume.
  int level(std::int64_t z, std::int64_t y, std::int64_t x) const {
    if (z < 0 || y < 0 || x < 0 || z >= shape_[0] || y >= shape_[1] || x >= shape_[2]) return 0;
    const auto brick = static_cast<std::size_t>(((z >> 3) * bricks_[1] + (y >> 3)) * bricks_[2] + (x >> 3));
    return levels_.tile(brick)[(z & 7) << 6 | (y & 7) << 3 | (x & 7)];
  }
  bool solid(const Index3& voxel) const { return level(voxel[0], voxel[1], voxel[2]) >= solid_level_; }
  bool solid(const Vec3& place) const { return solid(voxel_of(place)); }
  Index3 voxel_of(const Vec3& place) const {
    Index3 voxel;
    for (int axis = 0; axis < 3; ++axis) {
      // A place far away must not overflow: one voxel beyond the volume is as empty.
      const double at = (place[axis] - low_[axis]) * per_mm_[axis];
      voxel[2 - axis] = at < 0.0 ? -1 : std::int64_t(std::min(at, double(shape_[2 - axis])));
    }
    return voxel;
  }
  Vec3 center(const Index3& voxel) const;  ///< [mm]
  Vec3 center(std::size_t brick, int voxel) const;
  /// One number a voxel of the volume, for `support`.
  std::int64_t number(const Index3& voxel) const {
    return (voxel[0] * shape_[1] + voxel[1]) * shape_[2] + voxel[2];
  }
  bool solid_number(std::int64_t number) const;

  /// The first solid voxel that the segment from a place that is free meets; every voxel on the way is looked
  /// at, so no wall is too thin.
  bool first_hit(const Vec3& from, const Vec3& move, LevelHit& hit) const;
  /// Direction of the steepest fall of the levels around a hit; the face's normal where that points into it.
  Vec3 normal(const LevelHit& hit) const;

 private:
  Index3 shape_, bricks_;
  Vec3 spacing_, low_, high_, per_mm_;
  int solid_level_;
  Tiles levels_;
  std::vector<std::uint8_t> solid_;  // bricks that hold a solid voxel
  std::shared_ptr<const TissueMap> tissues_;
};

}  // namespace burrlab
