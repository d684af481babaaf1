// The constants of a tick's erosion by tissue, made before the tick so that the tick allocates nothing.
#pragma once

#include <cstdint>

#include "burrlab/voxel_bone.hpp"
#include "eroded_fraction.hpp"

namespace burrlab {

/// Throws unless the material may act in the bone: a bone with tissues takes only its tissues' material.
void check_material(const VoxelBone& bone, const Material& material);

/// `ErodedFraction` of every tissue, in arrays for vector loads.
struct ErosionSteps {
  static constexpr double largest = 1000.0;  ///< alpha dt above which a tick is refused

  double a[Tissues::most] = {};                ///< alpha dt by tissue
  float scale[Tissues::most] = {};             ///< a_k by tissue
  std::int32_t doublings[Tissues::most] = {};  ///< k by tissue
  std::int32_t most_doublings = 0;
  std::size_t count = 1;  ///< of tissues; 1 without

  /// a = alpha dt of a bone without tissues; throws if `a` is above `largest`.
  explicit ErosionSteps(double a);
  /// The constants for dt [ms], from the bone's tissues, or from the material in a bone without tissues.
  /// Throws if an alpha dt is above `largest`, or if the tissues have another material.
  ErosionSteps(const VoxelBone& bone, const Material& material, double dt);

  /// Each alpha dt times `factor` >= 0, at most `largest`. For a tick: no allocation or exception.
  ErosionSteps times(double factor) const noexcept;

 private:
  void set(std::size_t number, double alpha_dt) noexcept;
};

}  // namespace burrlab
