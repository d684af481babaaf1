// The hot path: the bricks that the sphere touches. No allocation, lock, virtual call, or libm beyond what is
// exact. A brick inside the sphere gives its stored sums, an empty one is skipped, the rest is visited row by
// row (kernel/brick_visit.hpp). Budget: 1 ms with the largest burr on the finest volume, measured by `make
// bench`. Design: docs/hierarchy.md. Lines that decide a bit follow docs/tick.md: change both or neither.

#include "tick.hpp"

#include <algorithm>
#include <array>
#include <bitset>
#include <cmath>
#include <cstring>
#include <sstream>

#include "brick_walk.hpp"
#include "kernel/kernel.hpp"
#include "portable_math.hpp"
#include "require.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {

static_assert(kernel::depth_row == kernel::depth_cell * (DepthTable::columns - 1) &&
              kernel::depth_rows_per_voxel == DepthTable::rows_per_voxel &&
              kernel::depth_columns_per_unit == DepthTable::columns_per_unit &&
              kernel::most_tissues == Tissues::most);

// Whether a brick holds so many tissues that a sum for each takes longer than a visit.
static bool too_many(std::uint64_t tissues) { return std::bitset<64>(tissues).count() > 6; }

// y to y^k, for a row of a brick.
static void raise_row(float* y, double k) {
  std::array<double, brick_side> row;
  std::copy_n(y, row.size(), row.begin());
  row = portable::pow(row, k);
  std::copy_n(row.begin(), row.size(), y);
}

// The voxel nearest to the centre, the rest of the position, and the bricks that the sphere may touch.
struct Tick::Placement {
  std::int64_t base[3];            // (x, y, z)
  double fraction[3];              // centre minus voxel `base` [voxel], a multiple of 2^-20
  std::int64_t first[3], last[3];  // bricks, inclusive, clipped to the volume; none where first > last
};

Tick::Tick(const VoxelBone& bone, double radius, Scheme scheme, const Shape& shape, std::uint64_t seed,
           std::uint32_t index)
    : kernel_(&kernel::current_kernel()),
      radius_(radius),
      scheme_(scheme),
      shape_(shape),
      seed_(seed),
      index_(index),
      spacing_(bone.spacing()) {
  const StandardArithmetic arithmetic;
  require_positive("radius", radius);
  if (index >= (1u << 31)) refuse("index", "below 2^31", index);
  isotropic_ = spacing_[0] == spacing_[1] && spacing_[1] == spacing_[2];
  resolution_ = radius / spacing_.maxCoeff();
  if (resolution_ < coarsest) {
    std::ostringstream text;
    text << "radius must be at least 4 voxels, got " << resolution_ << "; a spacing of " << radius / coarse
         << " mm or finer would do";
    throw InvalidArgument(text.str());
  }
  if (scheme == Scheme::layer && shape.kind() != Shape::Kind::constant)
    depth_ = DepthTable::of_order(shape.layer_order());
}

Tick::Placement Tick::place(const VoxelBone& bone, const Vec3& center) const {
  Placement at{};
  const double reach = radius_ + 0.51 * spacing_.maxCoeff();
  for (int axis = 0; axis < 3; ++axis) {
    require_finite("center", center[axis]);
    const double s = spacing_[axis];
    const auto n = static_cast<double>(bone.shape()[2 - axis]);
    // Far outside, any position without contact is as good.
    const double c = std::clamp((center[axis] - bone.origin()[axis]) / s, -1e9, 1e9);
    const double base = std::rint(c);
    at.base[axis] = static_cast<std::int64_t>(base);
    at.fraction[axis] = std::rint((c - base) * 1048576.0) / 1048576.0;
    const double low = std::clamp(std::ceil(c - reach / s), 0.0, n),
                 high = std::clamp(std::floor(c + reach / s), -1.0, n - 1.0);
    at.first[axis] = static_cast<std::int64_t>(low) / brick_side;
    at.last[axis] = high < 0.0 ? -1 : static_cast<std::int64_t>(high) / brick_side;
  }
  return at;
}

kernel::Sphere Tick::sphere(const Placement& at) const {
  kernel::Sphere sphere{};
  for (int axis = 0; axis < 3; ++axis) {
    sphere.fraction[axis] = static_cast<float>(at.fraction[axis]);
    sphere.spacing[axis] = static_cast<float>(spacing_[axis]);
  }
  sphere.spacing_inverse = 1.0f / sphere.spacing[0];
  sphere.radius = static_cast<float>(radius_);
  sphere.radius_inverse = 1.0f / sphere.radius;
  sphere.radius2_inverse = sphere.radius_inverse * sphere.radius_inverse;
  const double outer = radius_ + 0.501 * spacing_.maxCoeff();
  sphere.outer2 = static_cast<float>(outer * outer);
  const float deep = sphere.radius - 3.5f * static_cast<float>(spacing_.maxCoeff());
  sphere.deep2 = deep * deep;
  return sphere;
}

void Tick::prepare_erosion(kernel::Sphere& sphere, std::uint64_t tick) const {
  sphere.shape = shape_.kind() == Shape::Kind::constant ? kernel::shape_constant
                 : shape_.kind() == Shape::Kind::power  ? kernel::shape_power
                                                        : kernel::shape_linear;  // y = depth
  if (const Shape::Table* table = shape_.table()) {
    sphere.shape_table = table->nodes.data();
    sphere.table_size = static_cast<int>(table->nodes.size() / 3);
  }
  sphere.integer_order = shape_.table() && shape_.order() == 0.0 ? 1 : shape_.whole();
  sphere.exponent = shape_.order();
  sphere.power = &raise_row;
  sphere.depth_table = depth_ ? depth_->cells() : nullptr;
  sphere.draws = kernel::draws(seed_, tick, index_);
}

// One pass over the sphere: the sums of Eq. 1, the erosion of Eq. 4, or both, brick by brick. `eroded` is the
// bone itself where it erodes, else null.
template <bool summing, bool eroding>
TickSums Tick::pass(const VoxelBone& bone, VoxelBone* eroded, const Placement& at,
                    const kernel::Sphere& sphere, const ErosionSteps* steps) const {
  // The visits of this CPU path for this scheme and grid, indexed by whether the brick's tissues differ.
  const int layer = scheme_ == Scheme::layer, isotropic = isotropic_;
  const auto& visit =
      kernel_
          ->visit[eroding ? (summing ? kernel::both : kernel::erosion) : kernel::moments][layer][isotropic];
  const auto& erode_only = kernel_->visit[kernel::erosion][layer][isotropic];

  const TissueMap* map = bone.tissues().get();
  kernel::TissueTables tables{};
  if (map) {
    tables.stiffness = map->table().stiffnesses();
    tables.few = map->table().size() <= kernel::few_tissues;
  }
  if (map && eroding) {
    tables.fraction_scale = steps->scale;
    tables.doublings = steps->doublings;
    tables.most_doublings = steps->most_doublings;
  }
  const auto columns_in_row = static_cast<std::uint32_t>(bone.shape()[2]);
  const auto columns_in_slab = columns_in_row * static_cast<std::uint32_t>((bone.shape()[1] + 7) / 8);

  TickSums sums;
  const auto at_brick = [&](std::int64_t z, std::int64_t y, std::int64_t x, bool covered_whole) {
    const std::size_t number = bone.brick_number(z, y, x);
    const std::size_t tissue0 = map ? map->number(number) : 0;
    // null where all voxels have the same K and alpha
    const std::uint8_t* voxel_tissue = map && map->varies(number) ? map->tile(number) : nullptr;
    alignas(64) std::uint8_t before[brick_voxels];  // levels before erosion, to count the loss by tissue
    if (eroding && map && map->tile(number)) std::memcpy(before, bone.tile(number), brick_voxels);
    const std::int64_t from[3] = {brick_side * x - at.base[0], brick_side * y - at.base[1],
                                  brick_side * z - at.base[2]};

    kernel::Brick brick;
    brick.voxel_tissue = voxel_tissue;
    brick.tables = &tables;
    brick.fraction_scale = eroding ? steps->scale[tissue0] : 0.0f;
    brick.doublings = eroding ? steps->doublings[tissue0] : 0;
    brick.density = eroding ? eroded->open(number) : const_cast<std::uint8_t*>(bone.tile(number));
    brick.pristine = bone.pristine_tile(number);
    brick.level = bone.pristine_level(number);
    brick.x = static_cast<int>(from[0]);
    brick.y = static_cast<int>(from[1]);
    brick.z = static_cast<int>(from[2]);
    brick.column = static_cast<std::uint32_t>(brick_side * z) * columns_in_slab +
                   static_cast<std::uint32_t>(y) * columns_in_row +
                   static_cast<std::uint32_t>(brick_side * x);
    brick.columns_in_slab = columns_in_slab;
    brick.faint = bone.has_faint(number);

    // A brick wholly inside the sphere gives its stored sums [level]; all others are visited row by row.
    kernel::Sums part{};
    if (summing && covered_whole && !brick.faint && !(voxel_tissue && too_many(map->present(number)))) {
      const BrickSums& stored = bone.sums(number);
      part.mass = std::int64_t{256} * stored.mass;
      part.x = std::int64_t{256} * stored.x;
      part.y = std::int64_t{256} * stored.y;
      part.z = std::int64_t{256} * stored.z;
      if (voxel_tissue)
        part.stiffness = std::int64_t{256} * map->stiffness_sum(number, bone.tile(number), stored.mass);
      if (eroding) erode_only[voxel_tissue != nullptr](sphere, brick, part);
    } else {
      visit[voxel_tissue != nullptr](sphere, brick, part);
    }

    if (summing) {  // moves the origin of the first moments from the brick's voxel 0 to `base`
      if (map) sums.stiffness += voxel_tissue ? part.stiffness : tables.stiffness[tissue0] * part.mass;
      sums.mass += part.mass;
      sums.m1[0] += part.x + from[0] * part.mass;
      sums.m1[1] += part.y + from[1] * part.mass;
      sums.m1[2] += part.z + from[2] * part.mass;
      sums.faint += part.faint;
    }
    if (eroding)
      sums.lost += eroded->close({z, y, x}, number,
                                 {part.after_mass, part.after_x, part.after_y, part.after_z}, before);
  };
  const auto prefetch_brick = [&](std::int64_t z, std::int64_t y, std::int64_t x) {
    const std::size_t number = bone.brick_number(z, y, x);
    prefetch(bone.tile(number));
    if (map && map->tile(number)) prefetch(map->tile(number));
  };

  SphereInBricks ball;
  for (int axis = 0; axis < 3; ++axis) {
    ball.first[axis] = at.first[axis];
    ball.last[axis] = at.last[axis];
    ball.center[axis] = static_cast<double>(at.base[axis]) + at.fraction[axis];
    ball.spacing[axis] = spacing_[axis];
  }
  const double margin = 0.501 * spacing_.maxCoeff();
  ball.outer = radius_ + margin;
  ball.whole = radius_ - margin;
  walk_bricks(bone.occupancy(), ball, at_brick, prefetch_brick);
  return sums;
}

Moments Tick::to_moments(const VoxelBone& bone, const Placement& at, const TickSums& sums) const {
  Moments result;
  const double quantum = bone.voxel_volume() / 65280.0;  // volume of 1/256 level
  result.m0 = static_cast<double>(sums.mass) * quantum;  // Eq. 1
  for (int axis = 0; axis < 3; ++axis) {
    const double index_sum =
        static_cast<double>(sums.m1[axis]) - at.fraction[axis] * static_cast<double>(sums.mass);
    result.m1[axis] = index_sum * (spacing_[axis] * quantum);
  }
  return result;
}

Moments Tick::moments(const VoxelBone& bone, const Vec3& center, TickSums* sums) const {
  const Placement at = place(bone, center);
  const TickSums pass_sums = pass<true, false>(bone, nullptr, at, sphere(at), nullptr);
  if (sums) *sums = pass_sums;
  return to_moments(bone, at, pass_sums);
}

TickSums Tick::erode(VoxelBone& bone, const Vec3& center, const ErosionSteps& steps,
                     std::uint64_t tick) const {
  const Placement at = place(bone, center);
  kernel::Sphere ball = sphere(at);
  prepare_erosion(ball, tick);
  return pass<false, true>(bone, &bone, at, ball, &steps);
}

Moments Tick::moments_and_erode(VoxelBone& bone, const Vec3& center, const ErosionSteps& steps,
                                std::uint64_t tick, TickSums* sums) const {
  const Placement at = place(bone, center);
  kernel::Sphere ball = sphere(at);
  prepare_erosion(ball, tick);
  *sums = pass<true, true>(bone, &bone, at, ball, &steps);
  return to_moments(bone, at, *sums);
}

}  // namespace burrlab
