// The erosion of the rows of a brick, step by step.
#pragma once

#include "eroded_fraction.hpp"
#include "random.hpp"
#include "rows.hpp"

namespace burrlab::kernel {
namespace {

#ifdef _MSC_VER
#define BURRLAB_APART __declspec(noinline)
#define BURRLAB_RARE BURRLAB_APART
#else
#define BURRLAB_APART __attribute__((noinline))
#define BURRLAB_RARE __attribute__((noinline, cold))
#endif

/// What one step of the erosion hands to the next, by row. Each step goes through all rows: one voxel's
/// arithmetic is a long chain, and only many side by side keep the CPU busy.
struct Steps {
  struct alignas(64) Row {
    float mass[lanes];     // eroding [2^-16 level]
    float covered[lanes];  // before the clamp to w
    float r2[lanes];
    float e_part[lanes];  // of e and tau within a cell of the table
    float tau_part[lanes];
    std::uint32_t cell[lanes];  // offset in the table
    float width[lanes];         // w s/R
    float f[lanes];             // first y of f = y^k
    std::uint32_t number;
    alignas(64) float depth[lanes];  // R - r; from here on not needed as a rule
    float p_inverse[lanes];
    float relative_spacing[lanes];  // s/R
    float e[lanes];
  } row[brick_rows];
  alignas(64) std::int32_t u[brick_rows][lanes];  // by row, not by position in the list
};

/// The fraction left tau, the depth e of the covered part's outer face, and their cell in the table of G.
template <bool isotropic, bool plain>
inline void locate_in_table(const Constants& c, Steps& steps, int count) {
  // Below the last row and column, so that every cell has a neighbour.
  const Float most_e = set(3.0f - 0x1p-22f), most_tau = set(1.0f - 0x1p-24f);
  const Float rows_per_voxel = set(depth_rows_per_voxel), columns_per_unit = set(depth_columns_per_unit);
  for (int i = 0; i < count; ++i) {
    auto& step = steps.row[i];
    const Float covered = load(step.covered), w = smaller(larger(covered, c.least), c.one);
    const Float p_inverse = plain ? c.p_inverse : load(step.p_inverse);
    const Float tau = smaller((load(step.mass) * p_inverse) / w, most_tau);
    const Float e = larger(covered - c.one, c.zero);
    const Float te = smaller(e, most_e) * rows_per_voxel, tt = tau * columns_per_unit;
    const Integer row = truncate(te), column = truncate(tt);
    store(step.e_part, te - to_float(row));
    store(step.tau_part, tt - to_float(column));
    store(step.cell, cell_offset(row, column));
    store(step.width, w * (isotropic ? c.relative_spacing : load(step.relative_spacing)));
    if (!isotropic) store(step.e, e);
  }
}

/// f, or y of f = y^k, at the effective depth delta = w s/R G(e, tau) of the voxels' bone; G bilinear.
template <bool isotropic, bool power>
inline void find_f(const float* depth_table, const Constants& c, Steps& steps, int count) {
  const Float deepest = set(3.0f);
  for (int i = 0; i < count; ++i) {
    auto& step = steps.row[i];
    const Float fe = load(step.e_part), ft = load(step.tau_part);
    Float low, low_rise, high, high_rise;
    look_up(depth_table, step.cell, low, low_rise, high, high_rise);
    const Float lo = low + low_rise * ft, hi = high + high_rise * ft;
    Float delta = load(step.width) * (lo + (hi - lo) * fe);
    if (!isotropic) delta = select(deepest <= load(step.e), load(step.depth) * c.radius_inverse, delta);
    const Float r2 = load(step.r2);
    const Mask deep = r2 <= c.deep2;
    store(step.f, power ? select(deep, c.one - r2 * c.radius2_inverse, delta * (c.two - delta))
                        : select(deep, load(step.depth) * c.radius_inverse, delta));
  }
}

/// From depths to y of a table. Lane by lane: nodes may stand at any depths.
BURRLAB_APART void read_shape_table(const Sphere& at, Steps& steps, int count) {
  const float *depth = at.shape_table, *value = depth + at.table_size, *slope = value + at.table_size;
  for (int i = 0; i < count; ++i) {
    for (float& each : steps.row[i].f) {
      int node = 0;  // the last one that is not deeper
      for (int half = at.table_size / 2; half; half /= 2) node += depth[node + half] <= each ? half : 0;
      const float y = value[node] + (each - depth[node]) * slope[node];
      each = each > 0.0f && y > 0.0f ? y : 0.0f;
    }
  }
}

inline void raise_to_power(const Sphere& at, Steps& steps, int count) {  // y to y^k
  for (int i = 0; i < count; ++i) {
    if (at.integer_order == 0) {
      at.power(steps.row[i].f, at.exponent);
    } else {
      const Float y = load(steps.row[i].f);
      Float f = y;
      for (int k = 1; k < at.integer_order; ++k) f = f * y;
      store(steps.row[i].f, f);
    }
  }
}

/// Draws V where the low 16 bits of lambda + U are all ones: whether the rest of lambda carries.
BURRLAB_RARE Integer break_ties(const Sphere& at, const Brick& brick, unsigned row, Float scaled,
                                Integer lost, unsigned tie) {
  const int y = row & 7;
  const Float rest = (scaled - to_float(truncate(scaled))) * set(65536.0f) + set(0.5f);
  alignas(64) std::int32_t each[lanes], low[lanes];
  store(each, lost);
  store(low, truncate(rest));
  for (; tie; tie &= tie - 1) {
    const int lane = static_cast<int>(lowest_bit(tie));
    const std::uint32_t column =
        brick.column + (row >> 3) * brick.columns_in_slab + static_cast<std::uint32_t>(lane);
    each[lane] += draw_one(at, column, y, 1) < static_cast<std::uint32_t>(low[lane]);
  }
  return load(each);
}

/// Takes from every row the loss given by its mean lambda and by U. `mixed`: constants are by tissue. In two
/// loops: the CPU's scheduler holds the waiting operations of few rows, so short chains overlap better.
template <bool doubling, bool mixed>
inline void remove_levels(const Sphere& at, const Brick& brick, const Constants& c, Steps& steps, int count) {
  const Float c1 = set(ErodedFraction::c1), c2 = set(ErodedFraction::c2), c3 = set(ErodedFraction::c3);
  const TissueTables* tables = brick.tables;
  const int doublings = mixed ? tables->most_doublings : brick.doublings;
  std::uint8_t* tile = brick.density;
  for (int i = 0; i < count; ++i) {
    auto& step = steps.row[i];
    const std::uint8_t* tissue = brick.voxel_tissue + (mixed ? 8 * step.number : 0);
    const Float y =
        (mixed ? pick(tables->fraction_scale, tissue, tables->few) : c.fraction_scale) * load(step.f);
    Float eroded = y * (c.one - y * (c1 - y * (c2 - y * c3)));  // 1 - exp(-a f)
    if (doubling && mixed) {
      const Integer own = pick(tables->doublings, tissue, tables->few);
      for (int k = 0; k < doublings; ++k) eroded = select(own > set(k), eroded * (c.two - eroded), eroded);
    } else if (doubling) {
      for (int k = 0; k < doublings; ++k) eroded = eroded * (c.two - eroded);
    }
    store(step.f, eroded);
  }
  for (int i = 0; i < count; ++i) {
    const auto& step = steps.row[i];
    // Eq. 4 over the tick: lambda = M (1 - exp(-alpha f dt))
    const Float scaled = load(step.mass) * load(step.f);
    const Integer sum = truncate(scaled) + load(steps.u[step.number]);
    Integer lost = high16(sum);
    if (const unsigned tie = bits(low16(sum) == set(0xFFFF)))
      lost = break_ties(at, brick, step.number, scaled, lost, tie);
    take_from_row(tile + 8 * step.number, lost);
  }
}

}  // namespace
}  // namespace burrlab::kernel
