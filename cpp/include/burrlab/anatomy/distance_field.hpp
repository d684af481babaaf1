// Distances to a structure on a coarse grid around it, linear between the nodes: what is asked far from it.
#pragma once

#include <vector>

#include "burrlab/anatomy/structure_search.hpp"
#include "burrlab/types.hpp"

namespace burrlab {

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

}  // namespace burrlab
