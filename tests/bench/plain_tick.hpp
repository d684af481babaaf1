// The tick as a plain loop over the sphere in dense arrays: the benchmark's baseline, as in docs/tick.md.
#pragma once

#include <cstdint>
#include <memory>

#include "burrlab/types.hpp"
#include "depth_table.hpp"
#include "tick.hpp"

namespace burrlab::bench {

/// The sums of one pass over the sphere.
struct PlainSums {
  std::int64_t mass = 0;              ///< sum of M [1/256 level]
  std::int64_t first[3] = {0, 0, 0};  ///< sum of M times voxel index from the burr's, (x, y, z)
  std::int64_t lost = 0;              ///< levels removed
};

/// Moments and erosion by a burr in cubic voxels, f parabolic.
class PlainTick {
 public:
  /// shape (z, y, x); spacing [mm]; origin (x, y, z) [mm]; radius [mm].
  PlainTick(const Index3& shape, double spacing, const Vec3& origin, double radius, Scheme scheme,
            std::uint64_t seed, std::uint32_t index);

  /// One tick at `center` [mm] with a = alpha dt; `density` erodes in place.
  PlainSums step(std::uint8_t* density, const std::uint8_t* pristine, const Vec3& center, double a,
                 std::uint64_t tick) const;

 private:
  struct Place;  // the sphere's place in the grid
  class Draws;   // the random numbers of a tick

  Place place(const Vec3& center) const;
  template <Scheme scheme>
  PlainSums visit(std::uint8_t* density, const std::uint8_t* pristine, Place at, double a,
                  std::uint64_t tick) const;

  Index3 shape_;
  double spacing_;
  Vec3 origin_;
  double radius_, reach_;  // beyond the reach no voxel is covered
  Scheme scheme_;
  std::uint64_t seed_;
  std::uint32_t index_;
  std::shared_ptr<const DepthTable> depth_;
};

}  // namespace burrlab::bench
