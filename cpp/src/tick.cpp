// The hot path: one pass over the voxels that the sphere touches. No allocation, lock, virtual call or libm
// beyond sqrt. Every line that decides a bit follows docs/tick.md; change both or neither.

#include "burrlab/tick.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "burrlab/check.hpp"
#include "burrlab/philox.hpp"

namespace burrlab {

Scheme parse_scheme(const std::string& name) {
  if (name == "layer") return Scheme::layer;
  if (name == "cell") return Scheme::cell;
  throw std::invalid_argument("scheme must be layer or cell, got '" + name + "'");
}

// The voxel nearest to the centre, the rest of the position, and the box that the sphere may touch.
struct Tick::Placement {
  std::int64_t base[3];            // (x, y, z)
  double fraction[3];              // centre minus voxel `base` [voxel], a multiple of 2^-20
  std::int64_t first[3], last[3];  // half-open box, clipped to the volume
};

// The 16-bit random numbers of eight voxels along x at a time, drawn when first asked for.
struct Tick::Draws {
  std::uint64_t seed, tick;
  std::uint32_t index;

  PhiloxBlock block(std::int64_t octet, std::uint32_t draw) const {
    return philox4x32({static_cast<std::uint32_t>(octet), static_cast<std::uint32_t>(tick),
                       static_cast<std::uint32_t>(tick >> 32), index + (draw << 31)},
                      seed);
  }
  static int lane(const PhiloxBlock& block, std::int64_t x) {
    const int l = static_cast<int>(x & 7);
    return static_cast<int>((block[l >> 1] >> (16 * (l & 1))) & 0xFFFFu);
  }
};

Tick::Tick(const VoxelBone& bone, double radius, Scheme scheme, const Shape& shape, std::uint64_t seed,
           std::uint32_t index)
    : radius_(radius), scheme_(scheme), shape_(shape), seed_(seed), index_(index) {
  require_positive("radius", radius);
  if (index >= (1u << 31)) refuse("index", "below 2^31", index);
  const Vec3& s = bone.spacing();
  isotropic_ = s[0] == s[1] && s[1] == s[2];
  resolution_ = radius / s.maxCoeff();
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
  const double reach = radius_ + 0.5 * bone.spacing().maxCoeff();
  for (int axis = 0; axis < 3; ++axis) {
    require_finite("center", center[axis]);
    const double s = bone.spacing()[axis];
    const std::int64_t n = bone.shape()[2 - axis];
    // Far outside, any position without contact does as well.
    const double c = std::clamp((center[axis] - bone.origin()[axis]) / s, -1e9, 1e9);
    const double base = std::rint(c);
    at.base[axis] = static_cast<std::int64_t>(base);
    at.fraction[axis] = std::rint((c - base) * 1048576.0) / 1048576.0;
    const double extent = reach / s + 1.0;
    at.first[axis] = std::clamp<std::int64_t>(static_cast<std::int64_t>(std::floor(c - extent)), 0, n);
    at.last[axis] = std::clamp<std::int64_t>(static_cast<std::int64_t>(std::ceil(c + extent)) + 1, 0, n);
  }
  return at;
}

template <Scheme scheme, bool isotropic, bool eroding>
TickSums Tick::visit(const VoxelBone& bone, std::uint8_t* levels, const Placement& at,
                     const ErodedFraction* fraction, const Draws* draws) const {
  TickSums sums;
  const std::uint8_t* density = bone.density();
  const std::uint8_t* pristine = bone.pristine();
  const std::int64_t nx = bone.shape()[2], ny = bone.shape()[1], octets = (nx + 7) / 8;
  const float sx = static_cast<float>(bone.spacing()[0]), sy = static_cast<float>(bone.spacing()[1]),
              sz = static_cast<float>(bone.spacing()[2]);
  const float fx = static_cast<float>(at.fraction[0]), fy = static_cast<float>(at.fraction[1]),
              fz = static_cast<float>(at.fraction[2]);
  const float radius = static_cast<float>(radius_), inverse_radius = 1.0f / radius;
  const bool needs_depth = depth_ != nullptr;
  const double reach = radius_ + 0.501 * bone.spacing().maxCoeff();

  for (std::int64_t z = at.first[2]; z < at.last[2]; ++z) {
    const float dz = (static_cast<float>(z - at.base[2]) - fz) * sz;
    for (std::int64_t y = at.first[1]; y < at.last[1]; ++y) {
      const float dy = (static_cast<float>(y - at.base[1]) - fy) * sy;
      const float row2 = dz * dz + dy * dy;
      const double chord2 = reach * reach - row2;
      if (chord2 <= 0.0) continue;
      const double half = std::sqrt(chord2) / bone.spacing()[0] + 0.01;
      const double middle = static_cast<double>(at.base[0]) + at.fraction[0];
      const std::int64_t begin = std::max(at.first[0], static_cast<std::int64_t>(std::ceil(middle - half)));
      const std::int64_t end = std::min(at.last[0], static_cast<std::int64_t>(std::floor(middle + half)) + 1);
      const std::int64_t row = (z * ny + y) * nx;
      std::int64_t row_mass = 0;

      for (std::int64_t octet = begin >> 3; octet * 8 < end; ++octet) {
        const std::int64_t x0 = std::max(begin, octet * 8), x1 = std::min(end, octet * 8 + 8);
        if (octet * 8 + 8 <= nx) {
          std::uint64_t eight;
          std::memcpy(&eight, density + row + octet * 8, 8);
          if (eight == 0) continue;
        }
        PhiloxBlock block{};
        bool drawn = false;
        for (std::int64_t x = x0; x < x1; ++x) {
          const int q = density[row + x];
          if (q == 0) continue;
          const int p = pristine[row + x];

          // Distance and the covered fraction w of the voxel.
          const float dx = (static_cast<float>(x - at.base[0]) - fx) * sx;
          const float r = std::sqrt(row2 + dx * dx);
          float s = sx, inverse_s = 1.0f / sx;
          if constexpr (!isotropic) {
            const float ax = sx * dx, ay = sy * dy, az = sz * dz;
            const float g = std::sqrt((az * az + ay * ay) + ax * ax);
            if (r > 0.0f) {
              s = g / r;
              inverse_s = r / g;
            }
          }
          const float depth = radius - r;
          const float w = std::min(std::max(depth * inverse_s + 0.5f, 0.0f), 1.0f);
          if (w == 0.0f) continue;

          // Mass inside the sphere [1/256 level]; in `layer` what is left lies outside the sphere first.
          int mass;
          if constexpr (scheme == Scheme::cell) {
            mass = static_cast<int>(static_cast<float>(q) * (w * 256.0f) + 0.5f);
          } else {
            mass = 256 * q - static_cast<int>(static_cast<float>(p) * ((1.0f - w) * 256.0f) + 0.5f);
          }
          if (mass <= 0) continue;
          row_mass += mass;
          sums.first[0] += mass * (x - at.base[0]);
          sums.first[1] += mass * (y - at.base[1]);
          if (p < 32) sums.faint += mass;

          if constexpr (eroding) {
            // f at the voxel (`cell`) or at the effective depth of what it holds (`layer`).
            float f;
            if constexpr (scheme == Scheme::cell) {
              f = shape_.at_radius(r * inverse_radius);
            } else if (!needs_depth) {
              f = 1.0f;
            } else {
              float d;
              if (w < 1.0f) {
                const float tau =
                    std::min(static_cast<float>(mass) / ((static_cast<float>(p) * 256.0f) * w), 1.0f);
                d = (w * s) * (*depth_)(0.0f, tau);
              } else {
                const float e = std::max(depth * inverse_s - 0.5f, 0.0f);
                d = e >= 3.0f ? depth : s * (*depth_)(e, static_cast<float>(q) / static_cast<float>(p));
              }
              f = shape_.at_depth(std::min(std::max(d * inverse_radius, 0.0f), 1.0f));
            }

            // Expected loss lambda [level]; its whole part, and one more with the probability of the rest.
            const int eroding_mass = scheme == Scheme::cell ? 256 * q : mass;  // a uniform voxel erodes whole
            const float expected = (static_cast<float>(eroding_mass) * 0.00390625f) * (*fraction)(f);
            const int whole = static_cast<int>(expected);
            const float scaled = (expected - static_cast<float>(whole)) * 65536.0f;
            const int high = static_cast<int>(scaled);
            const int low = static_cast<int>((scaled - static_cast<float>(high)) * 65536.0f + 0.5f);
            int loss = whole;
            if ((high | low) != 0) {
              const std::int64_t counter = (z * ny + y) * octets + octet;
              if (!drawn) block = draws->block(counter, 0);
              drawn = true;
              const int u = Draws::lane(block, x);
              if (u < high || (u == high && Draws::lane(draws->block(counter, 1), x) < low)) ++loss;
            }
            loss = std::min(loss, q);
            levels[row + x] = static_cast<std::uint8_t>(q - loss);
            sums.lost += loss;
          }
        }
      }
      sums.mass += row_mass;
      sums.first[2] += row_mass * (z - at.base[2]);
    }
  }
  return sums;
}

template <bool eroding>
TickSums Tick::dispatch(const VoxelBone& bone, std::uint8_t* levels, const Placement& at,
                        const ErodedFraction* fraction, const Draws* draws) const {
  if (scheme_ == Scheme::layer) {
    return isotropic_ ? visit<Scheme::layer, true, eroding>(bone, levels, at, fraction, draws)
                      : visit<Scheme::layer, false, eroding>(bone, levels, at, fraction, draws);
  }
  return isotropic_ ? visit<Scheme::cell, true, eroding>(bone, levels, at, fraction, draws)
                    : visit<Scheme::cell, false, eroding>(bone, levels, at, fraction, draws);
}

Moments Tick::to_moments(const VoxelBone& bone, const Placement& at, const TickSums& sums) const {
  Moments result;
  const double quantum = bone.voxel_volume() / 65280.0;  // volume of 1/256 level
  result.m0 = static_cast<double>(sums.mass) * quantum;  // Eq. 1
  for (int axis = 0; axis < 3; ++axis) {
    const double index_sum =
        static_cast<double>(sums.first[axis]) - at.fraction[axis] * static_cast<double>(sums.mass);
    result.m1[axis] = index_sum * (bone.spacing()[axis] * quantum);
  }
  return result;
}

Moments Tick::moments(const VoxelBone& bone, const Vec3& center, TickSums* sums) const {
  const Placement at = place(bone, center);
  const TickSums found = dispatch<false>(bone, nullptr, at, nullptr, nullptr);
  if (sums) *sums = found;
  return to_moments(bone, at, found);
}

Moments Tick::erode(VoxelBone& bone, const Vec3& center, double a, std::uint64_t tick, TickSums* sums) const {
  if (!(a <= largest_step)) refuse("alpha dt", "at most 1000", a);
  const Placement at = place(bone, center);
  const ErodedFraction fraction(a);
  const Draws draws{seed_, tick, index_};
  const TickSums found = dispatch<true>(bone, bone.eroded(), at, &fraction, &draws);
  bone.account(found.lost);
  if (sums) *sums = found;
  return to_moments(bone, at, found);
}

}  // namespace burrlab
