// Distance to a structure: exact near it, from a field far from it.
//
//     const burrlab::StructureSearch nerve(*bone, bone->tissues()->table().find("facial nerve"));
//     burrlab::NearestVoxel nearest;  // kept from call to call
//     const double gap = nerve.distance({1.0, 0.0, 2.7}, nearest) - 3.0;  // of a burr of 3 mm [mm]
#pragma once

#include <atomic>
#include <cstdint>
#include <limits>
#include <memory>

#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// The voxel of a structure that was nearest in the last search. The next search begins with it.
struct NearestVoxel {
  Index3 at{};       ///< (z, y, x)
  bool any = false;  ///< there was a search
};

/// The exact distance from a point to a structure: to the nearest of its voxels, each a box. The structure is
/// all voxels with the tissue's number, whatever bone they hold.
class BURRLAB_API StructureSearch {
 public:
  /// Throws InvalidArgument if the bone has no tissues, the tissue is not in its table or has no voxel.
  StructureSearch(const VoxelBone& bone, std::size_t tissue);

  /// Distance of a point to the structure [mm], 0 inside it; infinity unless it is below `bound` [mm]. The
  /// result does not depend on `nearest`, which only shortens the search.
  double distance(const Vec3& point, NearestVoxel& nearest,
                  double bound = std::numeric_limits<double>::infinity()) const noexcept;

  std::size_t tissue() const { return tissue_; }  ///< its number
  /// Whether the bone has these tissues on this grid.
  bool fits(const VoxelBone& bone) const {
    return bone.tissues() == map_ && bone.spacing() == spacing_ && bone.origin() == origin_;
  }
  const std::shared_ptr<const TissueMap>& map() const { return map_; }  ///< in which it lies
  const Vec3& low() const { return low_; }    ///< corner of the box around the structure [mm]
  const Vec3& high() const { return high_; }  ///< the opposite corner [mm]

 private:
  struct Best;
  double edge(int axis, std::int64_t voxel) const {
    return origin_[axis] + (double(voxel) - 0.5) * spacing_[axis];
  }
  double gap(int axis, double point, std::int64_t first, std::int64_t last) const;
  void search_brick(const Index3& brick, const Vec3& point, Best& best) const;

  std::shared_ptr<const TissueMap> map_;
  std::size_t tissue_;
  Index3 shape_, bricks_;
  Vec3 spacing_, origin_, low_, high_;
  Occupancy where_;  // bricks that hold voxels of the structure
};

/// Distances on a coarse grid around a structure, linear between the nodes. A node near the structure gets
/// its exact distance when it is first asked for, also in several threads: each would store the same number.
class BURRLAB_API DistanceField {
 public:
  static constexpr double exact_to = 8.0;  ///< nodes nearer than this have the exact distance [mm]

  /// `estimate` (z, y, x): distances at the nodes [mm], wrong by at most `error` [mm]. Nodes that may be
  /// nearer than `exact_to` have the exact distance. `origin`: place of node (0, 0, 0), (x, y, z) [mm].
  /// Throws InvalidArgument unless `spacing` is above 0 and at most 0.4 mm and every side has 2 nodes.
  DistanceField(StructureSearch search, const Index3& shape, const float* estimate, double spacing,
                const Vec3& origin, double error);

  /// Distance of a point [mm]; infinity outside the grid. It does not depend on `nearest`.
  double at(const Vec3& point, NearestVoxel& nearest) const noexcept;
  /// Distance from a point inside the grid to its nearest face [mm]; negative outside.
  double depth(const Vec3& point) const noexcept;

  // Bounds of the error between exact nodes [mm]: a distance d is 1-Lipschitz, with second derivatives of at
  // most 1/d (docs/beyond_the_paper.md).
  double too_near() const { return 0.8661 * spacing_; }  ///< most that a distance is too small
  double too_far() const { return 0.5 * spacing_; }  ///< most too large, where the true one is 1 mm or less

  /// Distances below this come from exact nodes only [mm]: other nodes are 8 mm or more away, and the corners
  /// of a cell are at most 1.74 spacings apart.
  double exact_at_most() const { return exact_to - 2.0 * spacing_; }
  /// Between exact nodes the distance changes by at most this times the way, by 1 along each axis (float32).
  static constexpr double steepest = 1.7321;

  const StructureSearch& search() const { return search_; }  ///< of its structure

 private:
  float node(const Index3& at, NearestVoxel& nearest) const noexcept;

  StructureSearch search_;
  Index3 shape_;
  std::unique_ptr<std::atomic<float>[]> values_;  // not exact yet: -1 - estimate
  double spacing_, error_;
  Vec3 origin_;
};

/// The distance of a sphere's surface. If the centre moves by d < `within`, it changes by at most rate d.
struct SphereDistance {
  double value;   ///< at least -radius; infinity beyond the field [mm]
  double rate;    ///< [1]
  double within;  ///< not positive if nothing is known [mm]
};

/// The distance of a burr to a structure, for the loop: any number of threads, each with a NearestVoxel.
class BURRLAB_API StructureDistance {
 public:
  static constexpr double exact_below = 1.0;  ///< distances of a burr's surface below this are exact [mm]

  /// From the field around the structure.
  explicit StructureDistance(DistanceField field) : field_(std::move(field)) {}

  /// Distance of the surface of a sphere of `radius` [mm] at `center`: a function of these two alone.
  double of_sphere(const Vec3& center, double radius, NearestVoxel& nearest) const noexcept;

  /// `of_sphere`, with how far it can change.
  SphereDistance around(const Vec3& center, double radius, NearestVoxel& nearest) const noexcept;

  const StructureSearch& search() const { return field_.search(); }  ///< exact
  const DistanceField& field() const { return field_; }              ///< far from the structure

 private:
  double exact(const Vec3& center, double far, NearestVoxel& nearest) const noexcept;
  bool is_far(double value) const;  // as the field says

  DistanceField field_;
};

}  // namespace burrlab
