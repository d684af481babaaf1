#include "burrlab/specimen.hpp"

#include <algorithm>
#include <cmath>

#include "require.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {

VoxelBone block(const Vec3& low, const Vec3& high, double spacing, std::uint8_t level) {
  const StandardArithmetic arithmetic;
  require_positive("spacing", spacing);
  Index3 shape;
  Vec3 origin;
  for (int axis = 0; axis < 3; ++axis) {
    require_positive("every side of a block", high[axis] - low[axis]);
    const double first = std::floor(low[axis] / spacing + 1e-6);
    const double voxels = std::ceil(high[axis] / spacing - 1e-6) - first;
    if (!(voxels < 4294967296.0)) refuse("voxels along a side of a block", "below 2^32", voxels);
    shape[2 - axis] = std::int64_t(voxels);
    origin[axis] = (first + 0.5) * spacing;
  }
  return VoxelBone(shape, level, Vec3::Constant(spacing), origin);
}

VoxelBone half_space(const Burr& burr, double spacing, double depth) {
  const StandardArithmetic arithmetic;
  require_positive("spacing", spacing);
  require_positive("depth", depth);
  const double reach = burr.radius + spacing, deep = depth + spacing;
  const double cap = deep < reach ? std::sqrt(std::max(2.0 * reach * deep - deep * deep, 0.0)) : reach;
  const double width = cap + 2.0 * spacing;
  return block({-width, -width, -(depth + 3.0 * spacing)}, {width, width, 0.0}, spacing);
}

}  // namespace burrlab
