// Distance to a structure at the price of a field far from it, and exact near it.
#pragma once

#include "burrlab/anatomy/distance_field.hpp"
#include "burrlab/anatomy/structure_search.hpp"

namespace burrlab {

class StructureDistance {
 public:
  static constexpr double exact_below = 1.0;  ///< distances of a burr's surface below this are exact [mm]

  StructureDistance(StructureSearch search, DistanceField field)
      : search_(std::move(search)), field_(std::move(field)) {}

  /// Of the surface of a sphere of `radius` [mm] at `center`: at least -radius; infinity beyond the field. A
  /// function of centre and radius alone.
  double of_sphere(const Vec3& center, double radius, NearestVoxel& nearest) const noexcept {
    const double far = field_.at(center);
    if (!(far - radius < exact_below + field_.too_far())) return far - radius;
    return search_.distance(center, nearest, far + field_.too_near()) - radius;
  }

  const StructureSearch& search() const { return search_; }
  const DistanceField& field() const { return field_; }

 private:
  StructureSearch search_;
  DistanceField field_;
};

}  // namespace burrlab
