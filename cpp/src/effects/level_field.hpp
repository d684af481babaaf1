// A copy of the bone's levels for parcels: where a segment hits bone, and what each brick lost.
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
  double part = 0.0;         ///< part of the segment before the hit, 0..1
  Index3 voxel{};            ///< voxel that is hit, (z, y, x)
  Vec3 face = Vec3::Zero();  ///< normal of the face that is hit, against the segment
};

/// What a brick lost when its levels were exchanged.
struct BrickLoss {
  std::int64_t lost = 0;  ///< [levels]
  bool rose = false;      ///< some levels rose, as when a replay goes back
  std::array<std::uint8_t, brick_voxels> by_voxel;
};

class LevelField {
 public:
  /// Voxels of at least `solid_level` are solid.
  LevelField(const VoxelBone& bone, int solid_level);

  /// Sets a brick's levels; returns what it lost.
  BrickLoss exchange(std::size_t brick, const std::uint8_t* density);

  std::size_t brick_count() const { return solid_.size(); }
  const std::shared_ptr<const TissueMap>& tissues() const { return tissues_; }
  double quantum() const { return spacing_.prod() / 255.0; }  ///< one level of one voxel [mm^3]
  const Vec3& low() const { return low_; }                    ///< corner of the volume [mm]
  const Vec3& high() const { return high_; }                  ///< the opposite corner [mm]
  double least_spacing() const { return spacing_.minCoeff(); }

  /// Level of a voxel; 0 outside the volume.
  int level(std::int64_t z, std::int64_t y, std::int64_t x) const {
    if (z < 0 || y < 0 || x < 0 || z >= shape_[0] || y >= shape_[1] || x >= shape_[2]) return 0;
    return levels_.tile(number_in(bricks_, {z >> 3, y >> 3, x >> 3}))[(z & 7) << 6 | (y & 7) << 3 | (x & 7)];
  }
  bool solid(const Index3& voxel) const { return level(voxel[0], voxel[1], voxel[2]) >= solid_level_; }
  bool solid(const Vec3& place) const { return solid(voxel_of(place)); }
  Index3 voxel_of(const Vec3& place) const {
    Index3 voxel;
    for (int axis = 0; axis < 3; ++axis) {
      // A far place must not overflow; one voxel outside the volume is just as empty.
      const double at = (place[axis] - low_[axis]) * per_mm_[axis];
      voxel[2 - axis] = at < 0.0 ? -1 : std::int64_t(std::min(at, double(shape_[2 - axis])));
    }
    return voxel;
  }
  Vec3 center(const Index3& voxel) const;  ///< [mm]
  Vec3 center(std::size_t brick, int voxel) const;
  /// A voxel's number in the volume, for `support`.
  std::int64_t number(const Index3& voxel) const { return std::int64_t(number_in(shape_, voxel)); }
  bool solid_number(std::int64_t number) const { return solid(place_in(shape_, number)); }

  /// Finds the first solid voxel on a segment that begins in a free place. Looks at every voxel on the way,
  /// so no wall is too thin.
  bool first_hit(const Vec3& from, const Vec3& move, LevelHit& hit) const;
  /// Direction of the steepest fall of the levels around a hit; the face's normal if that points inwards.
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
