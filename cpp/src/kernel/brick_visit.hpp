// One brick of the tick, row by row in lanes: its mass inside the sphere, then its erosion. Included once per
// instruction set, after its lanes_*.hpp; all is local to that file. Bits follow docs/tick.md.
#pragma once

#include <string.h>

#include "erosion.hpp"
#include "random.hpp"
#include "rows.hpp"

namespace burrlab::kernel {
namespace {

/// Mass by lane, summed by y and by z.
struct Mass {
  Integer by_y[8], by_z[8], faint;

  Mass() : faint(set(0)) {
    for (Integer& each : by_y) each = set(0);
    for (Integer& each : by_z) each = set(0);
  }
  void add(unsigned row, Integer mass) {
    by_y[row & 7] = by_y[row & 7] + mass;
    by_z[row >> 3] = by_z[row >> 3] + mass;
  }
};

/// K of each voxel of a row.
inline Integer stiffness_of(const Brick& brick, unsigned row) {
  return pick(brick.tables->stiffness, brick.voxel_tissue + 8 * row, brick.tables->few);
}

/// A row that meets the sphere's boundary: its mass inside the sphere, added to `sum` and (times K) to
/// `km_sum`, and what its erosion needs, as step i. `plain`: the brick has one pristine level, not faint, and
/// f is a power; `mixed`: several tissues.
template <bool layer, bool isotropic, bool summing, bool eroding, bool plain, bool mixed>
inline void measure_row(const Sphere& at, const Brick& brick, const RowDistances& distances, Constants& c,
                        int i, unsigned row, Steps& steps, Mass& sum, Wide& km_sum) {
  const Integer q = load_row(brick.density + 8 * row);

  // r, and the covered fraction w of each voxel; for anisotropic voxels s is the spacing along the radius.
  const Float r2 = squared_distance(distances.r2, distances.x2, row);
  const Float r = square_root(r2);
  Float s_inverse = c.spacing_inverse, relative_spacing = c.relative_spacing;
  if (!isotropic) {
    const Float a = square_root(squared_distance(distances.a2, distances.ax2, row));
    const Mask off_centre = r > c.zero;
    relative_spacing = select(off_centre, a / select(off_centre, r, c.one), c.spacing) * c.radius_inverse;
    s_inverse = select(off_centre, r / select(off_centre, a, c.one), s_inverse);
  }
  const Float depth = c.radius - r;
  const Float covered = depth * s_inverse + c.half;
  const Float w = smaller(larger(covered, c.least), c.one);

  // Mass inside the sphere [1/256 level]; in `layer` the bone left fills the part outside the sphere first.
  Integer mass;
  if (layer) {
    if (!plain && brick.pristine) c.set_pristine(load_row(brick.pristine + 8 * row));
    mass = positive(times256(q) - truncate(c.p_levels * (c.one - w) + c.half));
  } else {
    mass = truncate(to_float(q) * (w * c.n256) + c.half);
  }
  if (summing) {  // Eq. 1: m_0 and, by index, m_1
    sum.add(row, mass);
    if (mixed) km_sum = add_product(km_sum, mass, stiffness_of(brick, row));
    if (layer && !plain && brick.faint) sum.faint = sum.faint + only(set(32) > c.p, mass);
  }

  if (eroding) steps.row[i].number = row;
  if (eroding && layer) {
    auto& step = steps.row[i];
    store(step.mass, to_float(mass) * c.n256);
    store(step.covered, covered);
    store(step.r2, r2);
    if (!plain) store(step.p_inverse, c.p_inverse);
    if (!isotropic) store(step.relative_spacing, relative_spacing);
    if (!isotropic || !plain) store(step.depth, depth);
  }
  if (eroding && !layer) {  // scheme `cell`: the whole voxel erodes at f(r/R)
    const Float ratio2 = r2 * c.radius2_inverse;
    Float f = c.one;
    if (at.shape == shape_linear) f = larger(c.one - r * c.radius_inverse, c.zero);
    if (at.shape == shape_power) f = c.one - ratio2;
    store(steps.row[i].mass, select(mass > set(0), to_float(q) * set(65536.0f), c.zero));
    store(steps.row[i].f, select(ratio2 > c.one, c.zero, f));
  }
}

/// A row of deep voxels, covered whole: M = q, and f at their own r; only y = depth takes a square root.
template <bool layer, bool summing, bool eroding, bool mixed>
inline void measure_deep_row(const Sphere& at, const Brick& brick, const RowDistances& distances,
                             const Constants& c, int i, unsigned row, Steps& steps, Mass& sum, Wide& km_sum) {
  const Integer q = load_row(brick.density + 8 * row);
  if (summing) {
    sum.add(row, times256(q));
    if (mixed) km_sum = add_product(km_sum, times256(q), stiffness_of(brick, row));
    if (layer && brick.faint) {
      const Integer p = brick.pristine ? load_row(brick.pristine + 8 * row) : c.p;
      sum.faint = sum.faint + only(set(32) > p, times256(q));
    }
  }
  if (eroding) {
    const Float r2 = squared_distance(distances.r2, distances.x2, row);
    Float f = c.one;
    if (at.shape == shape_power) f = c.one - r2 * c.radius2_inverse;
    if (at.shape == shape_linear) {
      const Float r = square_root(r2);
      f = layer ? (c.radius - r) * c.radius_inverse : c.one - r * c.radius_inverse;
    }
    steps.row[i].number = row;
    store(steps.row[i].mass, to_float(q) * set(65536.0f));
    store(steps.row[i].f, f);
  }
}

inline void sum_over_lanes(const Mass& sum, bool faint, Sums& sums) {
  Integer total = sum.by_y[0], above = sum.by_y[7], by_y = above, by_z = set(0);
  for (int y = 6; y > 0; --y) {  // sum of y M as a sum of partial sums, without products
    above = above + sum.by_y[y];
    by_y = by_y + above;
  }
  total = total + above;
  above = set(0);
  for (int z = 7; z > 0; --z) {
    above = above + sum.by_z[z];
    by_z = by_z + above;
  }
  std::int32_t each[4];
  horizontal_sums(total, times_index(total), by_y, by_z, each);
  sums.mass = each[0];
  sums.x = each[1];
  sums.y = each[2];
  sums.z = each[3];
  if (faint) {
    horizontal_sums(sum.faint, sum.faint, sum.faint, sum.faint, each);
    sums.faint = each[0];
  }
}

/// One brick in a tick: sums its mass inside the sphere (Eq. 1), then erodes it (Eq. 4), as `summing` and
/// `eroding` say. `mixed`: its voxels are of several tissues.
template <bool layer, bool isotropic, bool summing, bool eroding, bool mixed>
void visit(const Sphere& at, const Brick& brick, Sums& sums) {
  RowDistances distances;
  measure_distances<isotropic>(at, brick, distances);
  const RowsToVisit visited = rows_to_visit(at, brick, distances);

  // Row by row: M of each voxel, its part in the sums, and what the erosion needs of it.
  Constants c(at, brick);
  Steps steps;
  Mass mass;
  Wide km_sum = wide_zero();
  int count = 0;  // rows measured
  const bool plain = layer && !brick.pristine && !brick.faint && at.shape == shape_power;
  if (plain) {
    for (RowSet left = visited.shallow; left; left &= left - 1)
      measure_row<layer, isotropic, summing, eroding, true, mixed>(at, brick, distances, c, count++,
                                                                   lowest_bit(left), steps, mass, km_sum);
  } else {
    for (RowSet left = visited.shallow; left; left &= left - 1)
      measure_row<layer, isotropic, summing, eroding, false, mixed>(at, brick, distances, c, count++,
                                                                    lowest_bit(left), steps, mass, km_sum);
  }
  const int shallow = count;
  for (RowSet left = visited.deep; left; left &= left - 1)
    measure_deep_row<layer, summing, eroding, mixed>(at, brick, distances, c, count++, lowest_bit(left),
                                                     steps, mass, km_sum);
  if (summing) sum_over_lanes(mass, layer && brick.faint, sums);
  if (summing && mixed) sums.stiffness = total(km_sum);
  if (!eroding) return;

  // y of each voxel, in `layer` at the effective depth of its bone, by the depth table; then f = y^k.
  if (layer && at.shape == shape_constant) {
    for (int i = 0; i < shallow; ++i) store(steps.row[i].f, c.one);
  } else if (layer) {
    if (plain)
      locate_in_table<isotropic, true>(c, steps, shallow);
    else
      locate_in_table<isotropic, false>(c, steps, shallow);
    if (at.shape == shape_power)
      find_f<isotropic, true>(at.depth_table, c, steps, shallow);
    else
      find_f<isotropic, false>(at.depth_table, c, steps, shallow);
  }
  if (at.shape_table) read_shape_table(at, steps, count);
  if (at.shape != shape_constant && at.integer_order != 1) raise_to_power(at, steps, count);

  // The loss of each voxel: lambda = M (1 - exp(-alpha f dt)), rounded at random by U (Russian roulette).
  draw_slabs(at, brick, visited.shallow | visited.deep, steps.u);
  if (mixed ? brick.tables->most_doublings : brick.doublings)
    remove_levels<true, mixed>(at, brick, c, steps, count);
  else
    remove_levels<false, mixed>(at, brick, c, steps, count);
  sum_levels(brick.density, sums);
}

}  // namespace

#define BURRLAB_BY_TISSUES(layer, isotropic, summing, eroding) \
  {visit<layer, isotropic, summing, eroding, false>, visit<layer, isotropic, summing, eroding, true>}
#define BURRLAB_VISITS(summing, eroding)                                                                     \
  {                                                                                                          \
      {BURRLAB_BY_TISSUES(false, false, summing, eroding),                                                   \
       BURRLAB_BY_TISSUES(false, true, summing, eroding)},                                                   \
      {BURRLAB_BY_TISSUES(true, false, summing, eroding), BURRLAB_BY_TISSUES(true, true, summing, eroding)}, \
  }
#define BURRLAB_KERNEL(name)                                                               \
  {name,                                                                                   \
   {BURRLAB_VISITS(true, false), BURRLAB_VISITS(false, true), BURRLAB_VISITS(true, true)}, \
   sum_levels,                                                                             \
   sum_where,                                                                              \
   draw_field}

}  // namespace burrlab::kernel
