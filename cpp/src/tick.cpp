// The hot path: the bricks that the sphere touches. No allocation, lock, virtual call or libm beyond sqrt.
// A brick that is covered whole gives its stored sums, an empty one is never seen, the rest is visited row by
// row by the code of the CPU's instruction set (kernel/brick_visit.hpp). Budget: 1 ms with the largest burr on
// the finest volume; measured by tests/bench (`make bench`). Design: docs/hierarchy.md; every line that
// decides a bit follows docs/tick.md: change both or neither.

#include "burrlab/tick.hpp"

#include <algorithm>
#include <cmath>

#include "burrlab/check.hpp"
#include "burrlab/philox.hpp"
#include "kernel/kernel.hpp"

namespace burrlab {
namespace {

kernel::Draws draws(std::uint64_t seed, std::uint64_t tick, std::uint32_t who) {
  kernel::Draws d{};
  d.tick_low = static_cast<std::uint32_t>(tick);
  d.tick_high = static_cast<std::uint32_t>(tick >> 32);
  d.who = who;
  for (std::uint32_t round = 0; round < philox_rounds; ++round) {
    d.key[round][0] = static_cast<std::uint32_t>(static_cast<std::uint32_t>(seed) + round * philox_weyl[0]);
    d.key[round][1] = static_cast<std::uint32_t>(static_cast<std::uint32_t>(seed >> 32) + round * philox_weyl[1]);
  }
  const std::uint64_t b = std::uint64_t{philox_multiplier[1]} * d.tick_high;  // round 0, the same for all columns
  const std::uint64_t x0 = static_cast<std::uint32_t>(b >> 32) ^ d.tick_low ^ d.key[0][0];
  const std::uint64_t a = philox_multiplier[0] * x0;  // round 1
  d.after0_x2 = d.who ^ d.key[0][1];
  d.after1_x0 = static_cast<std::uint32_t>(b) ^ d.key[1][0];
  d.after1_x2 = static_cast<std::uint32_t>(a >> 32) ^ d.key[1][1];
  d.after1_x3 = static_cast<std::uint32_t>(a);
  return d;
}

// Least and largest squared distance along one axis, from the centre to the voxels of four neighbouring bricks.
struct Reach {
  double least[4], most[4];

  Reach(std::int64_t first_brick, double center, double spacing) {  // center in voxels
    for (int i = 0; i < 4; ++i) {
      const double low = (static_cast<double>(brick_side * (first_brick + i)) - center) * spacing;
      const double high = low + (brick_side - 1) * spacing;
      least[i] = low > 0.0 ? low * low : high < 0.0 ? high * high : 0.0;
      most[i] = std::max(low * low, high * high);
    }
  }
  double least_of_all() const { return std::min(std::min(least[0], least[1]), std::min(least[2], least[3])); }
};

int lowest_bit(std::uint64_t word) {
#ifdef _MSC_VER
  unsigned long i;
  _BitScanForward64(&i, word);
  return static_cast<int>(i);
#else
  return __builtin_ctzll(word);
#endif
}

// The bits of a word whose children lie within a box of child numbers, clipped to the word's 4^3.
std::uint64_t within(const std::int64_t first[3], const std::int64_t last[3], std::int64_t z, std::int64_t y,
                     std::int64_t x) {
  const auto span = [](std::int64_t low, std::int64_t high, std::int64_t parent) {
    const std::int64_t a = std::clamp<std::int64_t>(low - 4 * parent, 0, 4);
    const std::int64_t b = std::clamp<std::int64_t>(high + 1 - 4 * parent, 0, 4);
    return a < b ? ((1u << b) - (1u << a)) & 0xFu : 0u;
  };
  static constexpr std::uint64_t spread_y[16] = {0x0000, 0x000F, 0x00F0, 0x00FF, 0x0F00, 0x0F0F, 0x0FF0, 0x0FFF,
                                                 0xF000, 0xF00F, 0xF0F0, 0xF0FF, 0xFF00, 0xFF0F, 0xFFF0, 0xFFFF};
  static constexpr std::uint64_t spread_z[16] = {
      0x0000000000000000, 0x000000000000FFFF, 0x00000000FFFF0000, 0x00000000FFFFFFFF,
      0x0000FFFF00000000, 0x0000FFFF0000FFFF, 0x0000FFFFFFFF0000, 0x0000FFFFFFFFFFFF,
      0xFFFF000000000000, 0xFFFF00000000FFFF, 0xFFFF0000FFFF0000, 0xFFFF0000FFFFFFFF,
      0xFFFFFFFF00000000, 0xFFFFFFFF0000FFFF, 0xFFFFFFFFFFFF0000, 0xFFFFFFFFFFFFFFFF};
  return spread_z[span(first[2], last[2], z)] & spread_y[span(first[1], last[1], y)] * 0x0001000100010001u &
         span(first[0], last[0], x) * 0x1111111111111111u;
}

}  // namespace

Scheme parse_scheme(const std::string& name) {
  if (name == "layer") return Scheme::layer;
  if (name == "cell") return Scheme::cell;
  throw std::invalid_argument("scheme must be layer or cell, got '" + name + "'");
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
  require_positive("radius", radius);
  if (index >= (1u << 31)) refuse("index", "below 2^31", index);
  isotropic_ = spacing_[0] == spacing_[1] && spacing_[1] == spacing_[2];
  resolution_ = radius / spacing_.maxCoeff();
  if (resolution_ < coarsest) {
    std::ostringstream text;
    text << "radius must be at least 4 voxels, got " << resolution_ << "; a spacing of " << radius / coarse
         << " mm or finer would do";
    throw std::invalid_argument(text.str());
  }
  if (scheme == Scheme::layer && shape.kind() != Shape::Kind::constant)
    depth_ = DepthTable::of_order(shape.order());
}

Tick::Placement Tick::place(const VoxelBone& bone, const Vec3& center) const {
  Placement at{};
  const double reach = radius_ + 0.51 * spacing_.maxCoeff();
  for (int axis = 0; axis < 3; ++axis) {
    require_finite("center", center[axis]);
    const double s = spacing_[axis];
    const std::int64_t n = bone.shape()[2 - axis];
    // Far outside, any position without contact does as well.
    const double c = std::clamp((center[axis] - bone.origin()[axis]) / s, -1e9, 1e9);
    const double base = std::rint(c);
    at.base[axis] = static_cast<std::int64_t>(base);
    at.fraction[axis] = std::rint((c - base) * 1048576.0) / 1048576.0;
    const auto low = static_cast<std::int64_t>(std::ceil(c - reach / s));
    const auto high = static_cast<std::int64_t>(std::floor(c + reach / s));
    at.first[axis] = std::max<std::int64_t>(low, 0) / brick_side;
    at.last[axis] = high < 0 ? -1 : std::min(high, n - 1) / brick_side;
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

void Tick::prepare_erosion(kernel::Sphere& sphere, double a, std::uint64_t tick) const {
  if (!(a <= largest_step)) refuse("alpha dt", "at most 1000", a);
  const ErodedFraction fraction(a);
  sphere.fraction_scale = fraction.scale;
  sphere.doublings = fraction.doublings;
  sphere.shape = shape_.kind() == Shape::Kind::constant ? kernel::shape_constant
                 : shape_.kind() == Shape::Kind::linear ? kernel::shape_linear
                                                        : kernel::shape_power;
  sphere.whole = shape_.whole();
  sphere.exponent = shape_.order();
  sphere.power = &portable::pow;
  sphere.depth = depth_ ? depth_->cells() : nullptr;
  sphere.draws = draws(seed_, tick, index_);
}

template <bool summing, bool eroding>
TickSums Tick::pass(const VoxelBone& bone, VoxelBone* eroded, const Placement& at,
                    const kernel::Sphere& sphere) const {
  TickSums sums;
  if (at.first[0] > at.last[0] || at.first[1] > at.last[1] || at.first[2] > at.last[2]) return sums;
  const auto& visit_of = kernel_->visit;
  const int layer = scheme_ == Scheme::layer, isotropic = isotropic_;
  const kernel::Visit visit = visit_of[eroding ? (summing ? kernel::both : kernel::erosion) : kernel::moments][layer][isotropic];
  const kernel::Visit erode_only = visit_of[kernel::erosion][layer][isotropic];
  const Index3& shape = bone.shape();
  const auto columns_in_row = static_cast<std::uint32_t>(shape[2]);
  const auto columns_in_slab = columns_in_row * static_cast<std::uint32_t>((shape[1] + 7) / 8);
  double center[3];
  for (int axis = 0; axis < 3; ++axis) center[axis] = static_cast<double>(at.base[axis]) + at.fraction[axis];
  const double largest = spacing_.maxCoeff();
  const double outer = radius_ + 0.501 * largest, whole = radius_ - 0.501 * largest;
  const double outer2 = outer * outer, whole2 = whole * whole;

  const auto at_brick = [&](std::int64_t z, std::int64_t y, std::int64_t x, double most) {
    const std::size_t number = bone.brick_number(z, y, x);
    kernel::Brick brick;
    brick.density = eroding ? eroded->open(number) : const_cast<std::uint8_t*>(bone.tile(number));
    brick.pristine = bone.pristine_tile(number);
    brick.level = bone.pristine_level(number);
    const std::int64_t from[3] = {brick_side * x - at.base[0], brick_side * y - at.base[1], brick_side * z - at.base[2]};
    brick.x = static_cast<int>(from[0]);
    brick.y = static_cast<int>(from[1]);
    brick.z = static_cast<int>(from[2]);
    brick.column = static_cast<std::uint32_t>(brick_side * z) * columns_in_slab +
                   static_cast<std::uint32_t>(y) * columns_in_row + static_cast<std::uint32_t>(brick_side * x);
    brick.columns_in_slab = columns_in_slab;
    brick.faint = bone.has_faint(number);
    kernel::Sums found{};
    if (summing && most <= whole2 && !brick.faint) {  // no part of it outside
      const BrickSums& stored = bone.sums(number);
      found.mass = std::int64_t{256} * stored.mass;
      found.x = std::int64_t{256} * stored.x;
      found.y = std::int64_t{256} * stored.y;
      found.z = std::int64_t{256} * stored.z;
      if (eroding) erode_only(sphere, brick, found);
    } else {
      visit(sphere, brick, found);
    }
    if (summing) {
      sums.mass += found.mass;
      sums.first[0] += found.x + from[0] * found.mass;
      sums.first[1] += found.y + from[1] * found.mass;
      sums.first[2] += found.z + from[2] * found.mass;
      sums.faint += found.faint;
    }
    if (eroding)
      sums.lost += eroded->close({z, y, x}, number, {found.after_mass, found.after_x, found.after_y, found.after_z});
  };

  const auto in_block = [&](std::int64_t bz, std::int64_t by, std::int64_t bx) {
    std::uint64_t bricks = bone.occupancy().block(bz, by, bx) & within(at.first, at.last, bz, by, bx);
    if (!bricks) return;
    const Reach x(4 * bx, center[0], spacing_[0]), y(4 * by, center[1], spacing_[1]), z(4 * bz, center[2], spacing_[2]);
    if (x.least_of_all() + y.least_of_all() + z.least_of_all() > outer2) return;
    for (; bricks; bricks &= bricks - 1) {
      const int bit = lowest_bit(bricks), i = bit & 3, j = bit >> 2 & 3, k = bit >> 4;
      if (x.least[i] + y.least[j] + z.least[k] <= outer2)
        at_brick(4 * bz + k, 4 * by + j, 4 * bx + i, x.most[i] + y.most[j] + z.most[k]);
    }
  };

  std::int64_t low[3], high[3];  // blocks
  for (int axis = 0; axis < 3; ++axis) low[axis] = at.first[axis] / 4, high[axis] = at.last[axis] / 4;
  for (std::int64_t z = low[2] / 4; z <= high[2] / 4; ++z) {
    for (std::int64_t y = low[1] / 4; y <= high[1] / 4; ++y) {
      for (std::int64_t x = low[0] / 4; x <= high[0] / 4; ++x) {
        std::uint64_t blocks = bone.occupancy().block_of_blocks(z, y, x) & within(low, high, z, y, x);
        for (; blocks; blocks &= blocks - 1) {
          const int bit = lowest_bit(blocks);
          in_block(4 * z + (bit >> 4), 4 * y + (bit >> 2 & 3), 4 * x + (bit & 3));
        }
      }
    }
  }
  return sums;
}

Moments Tick::to_moments(const VoxelBone& bone, const Placement& at, const TickSums& sums) const {
  Moments result;
  const double quantum = bone.voxel_volume() / 65280.0;  // volume of 1/256 level
  result.m0 = static_cast<double>(sums.mass) * quantum;  // Eq. 1
  for (int axis = 0; axis < 3; ++axis) {
    const double index_sum =
        static_cast<double>(sums.first[axis]) - at.fraction[axis] * static_cast<double>(sums.mass);
    result.m1[axis] = index_sum * (spacing_[axis] * quantum);
  }
  return result;
}

Moments Tick::moments(const VoxelBone& bone, const Vec3& center, TickSums* sums) const {
  const Placement at = place(bone, center);
  const TickSums found = pass<true, false>(bone, nullptr, at, sphere(at));
  if (sums) *sums = found;
  return to_moments(bone, at, found);
}

void Tick::erode(VoxelBone& bone, const Vec3& center, double a, std::uint64_t tick, TickSums* sums) const {
  const Placement at = place(bone, center);
  kernel::Sphere ball = sphere(at);
  prepare_erosion(ball, a, tick);
  const TickSums found = pass<false, true>(bone, &bone, at, ball);
  if (sums) *sums = found;
}

Moments Tick::moments_and_erode(VoxelBone& bone, const Vec3& center, double a, std::uint64_t tick,
                                TickSums* sums) const {
  const Placement at = place(bone, center);
  kernel::Sphere ball = sphere(at);
  prepare_erosion(ball, a, tick);
  const TickSums found = pass<true, true>(bone, &bone, at, ball);
  if (sums) *sums = found;
  return to_moments(bone, at, found);
}

std::vector<std::uint16_t> random_field(const Index3& shape, std::uint64_t seed, std::uint64_t tick,
                                        std::uint32_t index, std::uint32_t draw) {
  const kernel::Kernel& code = kernel::current_kernel();
  const kernel::Draws d = draws(seed, tick, index + (draw << 31));
  const auto columns_in_row = static_cast<std::uint32_t>(shape[2]);
  const auto columns_in_slab = columns_in_row * static_cast<std::uint32_t>((shape[1] + 7) / 8);
  std::vector<std::uint16_t> out(static_cast<std::size_t>(shape[0] * shape[1] * shape[2]));
  for (std::int64_t z = 0; z < shape[0]; ++z) {
    for (std::int64_t y = 0; y < shape[1]; y += 8) {
      for (std::int64_t x = 0; x < shape[2]; x += 8) {
        std::uint16_t slabs[128];
        code.draw(d, static_cast<std::uint32_t>(z) * columns_in_slab + static_cast<std::uint32_t>(y / 8) * columns_in_row +
                         static_cast<std::uint32_t>(x), columns_in_slab, slabs);
        for (std::int64_t j = y; j < std::min(y + 8, shape[1]); ++j)
          for (std::int64_t i = x; i < std::min(x + 8, shape[2]); ++i)
            out[static_cast<std::size_t>((z * shape[1] + j) * shape[2] + i)] = slabs[8 * (j - y) + i - x];
      }
    }
  }
  return out;
}

}  // namespace burrlab
