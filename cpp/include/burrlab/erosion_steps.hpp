// What a tick's erosion needs of alpha dt, by tissue; made before the tick, so that it allocates nothing.
#pragma once

#include <cstdint>

#include "burrlab/eroded_fraction.hpp"
#include "burrlab/material.hpp"
#include "burrlab/tissues.hpp"
#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// Throws unless a burr of this material may act in the bone: one with tissues has a material of its own.
void check_material(const VoxelBone& bone, const Material& material);

/// `ErodedFraction` of every tissue, side by side for vector loads.
struct ErosionSteps {
  static constexpr double largest = 1000.0;  ///< alpha dt above which a tick is refused

  float scale[Tissues::most];             ///< a_k by tissue
  std::int32_t doublings[Tissues::most];  ///< k by tissue
  std::int32_t most_doublings = 0;

  /// The same a = alpha dt for all; throws if it is above `largest`.
  explicit ErosionSteps(double a);
  /// dt [ms] at the rates of the bone's tissues, or at the material's in a bone without; throws if an alpha
  /// dt is above `largest`, or the material is not that of the tissues.
  ErosionSteps(const VoxelBone& bone, const Material& material, double dt);

 private:
  void set(std::size_t first, std::size_t end, double a);
};

}  // namespace burrlab
