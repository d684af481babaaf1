// The tick: moments of the bone inside the sphere (Eq. 1) and its erosion (Eq. 4), as in docs/tick.md.
#pragma once

#include <cstdint>
#include <memory>

#include "burrlab/force.hpp"
#include "depth_table.hpp"
#include "erosion_steps.hpp"

namespace burrlab {

namespace kernel {
struct Kernel;
struct Sphere;
struct TissueTables;
}  // namespace kernel

/// Exact sums of one pass over the sphere; their order does not matter.
struct TickSums {
  std::int64_t mass = 0;           ///< sum of M [1/256 level]
  std::int64_t m1[3] = {0, 0, 0};  ///< sum of M times voxel index from the centre's voxel, (x, y, z)
  std::int64_t faint = 0;          ///< part of `mass` in voxels with p < 32, where `layer` errs
  std::int64_t lost = 0;           ///< levels removed
  std::int64_t stiffness = 0;      ///< sum of K M, of a bone with tissues [1/4096 N/mm^2 times 1/256 level]
};

/// `elastic_force` where the arithmetic is set already.
ElasticForce force_of(const Moments& moments, double radius, double c_e, double force_exponent);

/// The sphere in the grid of one bone.
class Tick {
 public:
  static constexpr double coarsest = 4.0;  ///< R/s below which a burr is refused
  static constexpr double coarse = 7.5;    ///< R/s below which results are flagged

  Tick(const VoxelBone& bone, double radius, Scheme scheme, const Shape& shape, std::uint64_t seed,
       std::uint32_t index);

  /// Moments at `center` [mm], without erosion.
  Moments moments(const VoxelBone& bone, const Vec3& center, TickSums* sums = nullptr) const;
  /// Erosion by one step, with the draws of `tick`, without moments.
  TickSums erode(VoxelBone& bone, const Vec3& center, const ErosionSteps& steps, std::uint64_t tick) const;
  /// Moments and erosion in one pass; the moments are those before the erosion.
  Moments moments_and_erode(VoxelBone& bone, const Vec3& center, const ErosionSteps& steps,
                            std::uint64_t tick, TickSums* sums) const;

  double resolution() const { return resolution_; }  ///< R/s, s the largest spacing

 private:
  struct Placement;  // the sphere's place in the grid

  Placement place(const VoxelBone& bone, const Vec3& center) const;
  kernel::Sphere sphere(const Placement& at) const;
  void prepare_erosion(kernel::Sphere& sphere, std::uint64_t tick) const;
  template <bool summing, bool eroding>
  TickSums pass(const VoxelBone& bone, VoxelBone* eroded, const Placement& at, const kernel::Sphere& sphere,
                const ErosionSteps* steps) const;
  Moments to_moments(const VoxelBone& bone, const Placement& at, const TickSums& sums) const;

  const kernel::Kernel* kernel_;
  double radius_;
  Scheme scheme_;
  Shape shape_;
  std::uint64_t seed_;
  std::uint32_t index_;
  Vec3 spacing_;
  bool isotropic_;
  double resolution_;
  std::shared_ptr<const DepthTable> depth_;  // null where f needs no depth
};

/// U (draw 0) or V (draw 1) of a tick for every voxel of a volume of `shape`, (z, y, x). For tests.
std::vector<std::uint16_t> random_field(const Index3& shape, std::uint64_t seed, std::uint64_t tick,
                                        std::uint32_t index, std::uint32_t draw);

}  // namespace burrlab
