// Distance to a structure at the price of a field far from it, and exact near it.
#pragma once

#include <algorithm>
#include <cmath>

#include "burrlab/anatomy/distance_field.hpp"
#include "burrlab/anatomy/structure_search.hpp"

namespace burrlab {

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
