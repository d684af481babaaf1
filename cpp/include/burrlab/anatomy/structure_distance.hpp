// Distance to a structure at the price of a field far from it, and exact near it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "burrlab/brick.hpp"
#include "burrlab/tissues.hpp"
#include "burrlab/types.hpp"
#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// The voxel of a structure that was nearest the last time: where the next search begins.
struct NearestVoxel {
  Index3 at{};  ///< (z, y, x)
  bool any = false;
};

/// The exact distance of a point to a structure as segmented: to the nearest of its voxels, each a box. Those
/// are all voxels that carry the tissue's number, whatever bone was or is in them.
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

/// Distances on a coarse grid around a structure, linear between the nodes: what is asked far from it.
class DistanceField {
 public:
  static constexpr double exact_to = 8.0;  ///< nodes nearer than this have the exact distance [mm]

  /// `estimate` (z, y, x): distances at the nodes [mm], wrong by at most `error` [mm]; those that may be
  /// below `exact_to` are searched and made exact. `origin`: place of node (0, 0, 0), (x, y, z) [mm].
  DistanceField(const StructureSearch& search, const Index3& shape, std::vector<float> estimate,
                double spacing, const Vec3& origin, double error);

  /// Distance of a point [mm]; infinity beyond the grid.
  double at(const Vec3& point) const noexcept;
  /// Of a point within the grid to its nearest face [mm]; below 0 beyond it.
  double depth(const Vec3& point) const noexcept;

  // Bounds between exact nodes [mm], from the distance being 1-Lipschitz, and its second derivatives at most
  // one over it (docs/anatomy.md).
  double too_near() const { return 0.8661 * spacing_; }  ///< it says at most that much less than is true
  double too_far() const { return 0.5 * spacing_; }      ///< where 1 mm or less is true, that much more

  /// Below this no other than exact nodes are read [mm]: the others are 8 mm or more away, and the corners of
  /// a cell 1.74 spacings at most from one another.
  double exact_at_most() const { return exact_to - 2.0 * spacing_; }
  /// Between exact nodes it changes by at most this times the way: by 1 along each axis, and nodes are
  /// float32.
  static constexpr double steepest = 1.7321;

  const Index3& shape() const { return shape_; }
  double spacing() const { return spacing_; }     ///< [mm]
  const Vec3& origin() const { return origin_; }  ///< [mm]
  const std::vector<float>& values() const { return values_; }

 private:
  Index3 shape_;
  std::vector<float> values_;
  double spacing_;
  Vec3 origin_;
};

/// The distance of a sphere's surface, and what it can become: while the centre moves by less than `within`,
/// it changes by at most `rate` times as much.
struct SphereDistance {
  double value;   ///< at least -radius; infinity beyond the field [mm]
  double rate;    ///< [1]
  double within;  ///< not positive where nothing can be said [mm]
};

class StructureDistance {
 public:
  static constexpr double exact_below = 1.0;  ///< distances of a burr's surface below this are exact [mm]

  StructureDistance(StructureSearch search, DistanceField field)
      : search_(std::move(search)), field_(std::move(field)) {}

  /// Of the surface of a sphere of `radius` [mm] at `center`: a function of these two alone.
  double of_sphere(const Vec3& center, double radius, NearestVoxel& nearest) const noexcept {
    const double far = field_.at(center);
    return is_far(far - radius) ? far - radius : exact(center, far, nearest) - radius;
  }

  /// The same, and what it can become.
  SphereDistance around(const Vec3& center, double radius, NearestVoxel& nearest) const noexcept {
    const double far = field_.at(center), depth = field_.depth(center);
    if (std::isinf(far)) return {far, 1.0, -depth};
    if (!is_far(far - radius)) {
      const double value = exact(center, far, nearest) - radius;
      return {value, 1.0, std::min(exact_below - value, depth)};  // beyond, the field may be asked
    }
    const double rate = DistanceField::steepest;
    const double near = far - radius - exact_below - field_.too_far(), beyond = field_.exact_at_most() - far;
    return {far - radius, rate, std::min({near / rate, beyond / rate, depth})};
  }

  const StructureSearch& search() const { return search_; }
  const DistanceField& field() const { return field_; }

 private:
  double exact(const Vec3& center, double far, NearestVoxel& nearest) const noexcept {
    return search_.distance(center, nearest, far + field_.too_near());
  }
  bool is_far(double value) const { return !(value < exact_below + field_.too_far()); }  // by the field

  StructureSearch search_;
  DistanceField field_;
};

}  // namespace burrlab
