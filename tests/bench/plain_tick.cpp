#include "plain_tick.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "philox.hpp"

namespace burrlab::bench {

// The voxel nearest to the burr's centre, the rest of the position [voxel], and the sphere's box; (x, y, z).
struct PlainTick::Place {
  std::int64_t base[3], begin[3], end[3];
  float frac[3];
  double position[3];
};

/// G at e in [0, 3], tau in [0, 1], between the nodes of the table.
static float effective_depth(const DepthTable& table, float e, float tau) {
  constexpr int rows = DepthTable::rows, columns = DepthTable::columns;
  const float te = e * DepthTable::rows_per_voxel, tt = tau * DepthTable::columns_per_unit;
  const int i = std::min(static_cast<int>(te), rows - 2), j = std::min(static_cast<int>(tt), columns - 2);
  const float fe = te - static_cast<float>(i), ft = tt - static_cast<float>(j);
  const float* row = &table.nodes()[static_cast<std::size_t>(i * columns + j)];
  const float lo = row[0] + (row[1] - row[0]) * ft;
  const float hi = row[columns] + (row[columns + 1] - row[columns]) * ft;
  return lo + (hi - lo) * fe;
}

/// 1 - exp(-a f).
static float eroded_part(const ErodedFraction& of, float f) {
  const float y = of.scale * f;
  float p = y * (1.0f - y * (of.c1 - y * (of.c2 - y * of.c3)));
  for (int i = 0; i < of.doublings; ++i) p = p * (2.0f - p);
  return p;
}

// One Philox block per column of eight rows along y, drawn when first needed.
class PlainTick::Draws {
 public:
  Draws(const PlainTick& burr, std::uint64_t tick, std::size_t columns)
      : burr_(burr), tick_(tick), block_(columns), drawn_(columns) {}

  void next_columns() { std::fill(drawn_.begin(), drawn_.end(), std::uint8_t{0}); }

  int u(std::size_t i, std::int64_t column, std::int64_t y) {
    if (!drawn_[i]) {
      block_[i] = block(column, 0);
      drawn_[i] = 1;
    }
    return lane(block_[i], y);
  }
  int v(std::int64_t column, std::int64_t y) const { return lane(block(column, 1), y); }

 private:
  PhiloxBlock block(std::int64_t column, std::uint32_t draw) const {
    return philox4x32<7>({static_cast<std::uint32_t>(column), static_cast<std::uint32_t>(tick_),
                          static_cast<std::uint32_t>(tick_ >> 32), burr_.index_ + (draw << 31)},
                         burr_.seed_);
  }
  static int lane(const PhiloxBlock& block, std::int64_t y) {
    return static_cast<int>((block[(y & 7) >> 1] >> (16 * (y & 1))) & 0xFFFFu);
  }

  const PlainTick& burr_;
  std::uint64_t tick_;
  std::vector<PhiloxBlock> block_;
  std::vector<std::uint8_t> drawn_;
};

PlainTick::PlainTick(const Index3& shape, double spacing, const Vec3& origin, double radius, Scheme scheme,
                     std::uint64_t seed, std::uint32_t index)
    : shape_(shape),
      spacing_(spacing),
      origin_(origin),
      radius_(radius),
      reach_(radius + 0.501 * spacing),
      scheme_(scheme),
      seed_(seed),
      index_(index),
      depth_(DepthTable::of_order(1.0)) {}

PlainTick::Place PlainTick::place(const Vec3& center) const {
  Place at;
  for (int axis = 0; axis < 3; ++axis) {
    const double c = (center[axis] - origin_[axis]) / spacing_, base = std::rint(c);
    const double frac = std::rint((c - base) * 1048576.0) / 1048576.0;
    at.base[axis] = static_cast<std::int64_t>(base);
    at.frac[axis] = static_cast<float>(frac);
    at.position[axis] = base + frac;
    const double extent = reach_ / spacing_ + 1.0;
    const std::int64_t n = shape_[2 - axis];
    at.begin[axis] = std::clamp<std::int64_t>(static_cast<std::int64_t>(c - extent), 0, n);
    at.end[axis] = std::clamp<std::int64_t>(static_cast<std::int64_t>(c + extent) + 1, 0, n);
  }
  return at;
}

template <Scheme scheme>
PlainSums PlainTick::visit(std::uint8_t* density, const std::uint8_t* pristine, Place at, double a,
                           std::uint64_t tick) const {
  const std::int64_t ny = shape_[1], nx = shape_[2], groups = (ny + 7) / 8;
  const float R = static_cast<float>(radius_), inv_R = 1.0f / R, inv_R2 = inv_R * inv_R;
  const float s = static_cast<float>(spacing_), inv_s = 1.0f / s;
  const float deep = R - 3.5f * s, deep2 = deep * deep;
  const float least_w = 0x1p-20f, most_e = 3.0f - 0x1p-22f, most_tau = 1.0f - 0x1p-24f;
  const DepthTable& depth_table = *depth_;
  const ErodedFraction eroded_fraction(a);
  Draws draws(*this, tick, static_cast<std::size_t>(std::max<std::int64_t>(at.end[0] - at.begin[0], 0)));
  PlainSums sums;

  for (std::int64_t z = at.begin[2]; z < at.end[2]; ++z) {
    const float dz = (static_cast<float>(z - at.base[2]) - at.frac[2]) * s;
    for (std::int64_t y = at.begin[1]; y < at.end[1]; ++y) {
      if ((y & 7) == 0 || y == at.begin[1]) draws.next_columns();
      const float dy = (static_cast<float>(y - at.base[1]) - at.frac[1]) * s;
      const float row2 = dz * dz + dy * dy;
      const double chord2 = reach_ * reach_ - row2;
      if (chord2 <= 0.0) continue;
      const double half = std::sqrt(chord2) / spacing_;
      const auto left = static_cast<std::int64_t>(std::ceil(at.position[0] - half));
      const auto right = static_cast<std::int64_t>(std::floor(at.position[0] + half));
      const std::int64_t end = std::min(at.end[0], right + 1);
      std::int64_t row_mass = 0;

      for (std::int64_t x = std::max(at.begin[0], left); x < end; ++x) {
        const std::int64_t voxel = (z * ny + y) * nx + x;
        const int q = density[voxel];
        if (q == 0) continue;

        // Mass inside the sphere [1/256 level], and the erosion shape f at its place.
        const float dx = (static_cast<float>(x - at.base[0]) - at.frac[0]) * s;
        const float r2 = row2 + dx * dx;
        int mass = 256 * q;
        float f = 1.0f - r2 * inv_R2;
        if (r2 > deep2) {
          const float depth = R - std::sqrt(r2);
          const float w = std::min(std::max(depth * inv_s + 0.5f, least_w), 1.0f);
          if constexpr (scheme == Scheme::cell) {
            mass = static_cast<int>(static_cast<float>(q) * (w * 256.0f) + 0.5f);
            if (mass == 0) continue;
            if (r2 * inv_R2 > 1.0f) f = 0.0f;
          } else {
            const auto p = static_cast<float>(pristine[voxel]);
            mass -= static_cast<int>(p * ((1.0f - w) * 256.0f) + 0.5f);
            if (mass <= 0) continue;
            const float tau = std::min((static_cast<float>(mass) * (1.0f / (p * 256.0f))) / w, most_tau);
            const float e = std::min(std::max((depth * inv_s + 0.5f) - 1.0f, 0.0f), most_e);
            const float delta = (w * (s * inv_R)) * effective_depth(depth_table, e, tau);
            f = delta * (2.0f - delta);
          }
        }
        row_mass += mass;
        sums.first[0] += mass * (x - at.base[0]);

        // The expected loss [2^-16 level], rounded up or down by the voxel's random number.
        const int eroding = scheme == Scheme::cell ? 256 * q : mass;
        const float lambda = (static_cast<float>(eroding) * 256.0f) * eroded_part(eroded_fraction, f);
        const int whole = static_cast<int>(lambda);
        const std::int64_t column = (z * groups + (y >> 3)) * nx + x;
        const int total = whole + draws.u(static_cast<std::size_t>(x - at.begin[0]), column, y);
        int loss = total >> 16;
        if ((total & 0xFFFF) == 0xFFFF) {
          const int lo = static_cast<int>((lambda - static_cast<float>(whole)) * 65536.0f + 0.5f);
          loss += draws.v(column, y) < lo;
        }
        density[voxel] = static_cast<std::uint8_t>(q - loss);
        sums.lost += loss;
      }
      sums.mass += row_mass;
      sums.first[1] += row_mass * (y - at.base[1]);
      sums.first[2] += row_mass * (z - at.base[2]);
    }
  }
  return sums;
}

PlainSums PlainTick::step(std::uint8_t* density, const std::uint8_t* pristine, const Vec3& center, double a,
                          std::uint64_t tick) const {
  const Place at = place(center);
  return scheme_ == Scheme::layer ? visit<Scheme::layer>(density, pristine, at, a, tick)
                                  : visit<Scheme::cell>(density, pristine, at, a, tick);
}

}  // namespace burrlab::bench
