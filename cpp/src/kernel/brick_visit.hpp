// One brick of the tick, row by row in lanes. Included once by the file of each instruction set, after its
// lanes_*.hpp; everything is local to that file. Every line that decides a bit follows docs/tick.md.
#pragma once

namespace burrlab::kernel {
namespace {

#ifdef _MSC_VER
#define BURRLAB_RARE __declspec(noinline)
#else
#define BURRLAB_RARE __attribute__((noinline, cold))
#endif

constexpr int slabs = lanes / 8;  // rows (z, y) and, with 16 lanes, (z + 1, y) side by side

constexpr int units = 512 / lanes;  // vectors in a brick; unit i is the row y = i % 8 at z = slabs (i / 8)

using Units = std::uint64_t;  // one bit a unit

inline unsigned lowest(Units bits) {
#if defined(_MSC_VER)
  unsigned long i;
  _BitScanForward64(&i, bits);
  return static_cast<unsigned>(i);
#else
  return static_cast<unsigned>(__builtin_ctzll(bits));
#endif
}

/// U of a slab (or two): word i of a column holds the voxels y = 2i and 2i + 1.
struct Draw {
  Integer word[4];
};

inline Draw draw(const Draws& d, std::uint32_t column, std::uint32_t columns_in_slab) {
  const Words m0 = all_words(0xD2511F53u), m1 = all_words(0xCD9E8D57u);
  const Words first = product(first_words(column, column + columns_in_slab), m0);
  const Words second = product(high(first) ^ all_words(d.after0_x2), m1);
  Words x0 = high(second) ^ all_words(d.after1_x0), x1 = second;
  Words x2 = first ^ all_words(d.after1_x2), x3 = all_words(d.after1_x3);
  for (int round = 2; round < 7; ++round) {
    const Words a = product(x0, m0), b = product(x2, m1);
    x0 = exclusive_or(x1, all_words(d.key[round][0]), high(b));  // the last comes latest
    x1 = b;
    x2 = exclusive_or(x3, all_words(d.key[round][1]), high(a));
    x3 = a;
  }
  return {{in_order(x0), in_order(x1), in_order(x2), in_order(x3)}};
}

/// U (draw 0) or V (draw 1) of one voxel.
inline std::uint32_t draw_one(const Sphere& at, std::uint32_t column, int y, std::uint32_t which) {
  std::uint32_t x[4] = {column, at.draws.tick_low, at.draws.tick_high, at.draws.who + (which << 31)};
  for (int round = 0; round < 7; ++round) {
    const std::uint64_t a = std::uint64_t{0xD2511F53u} * x[0], b = std::uint64_t{0xCD9E8D57u} * x[2];
    x[0] = static_cast<std::uint32_t>((b >> 32) ^ x[1] ^ at.draws.key[round][0]);
    x[1] = static_cast<std::uint32_t>(b);
    x[2] = static_cast<std::uint32_t>((a >> 32) ^ x[3] ^ at.draws.key[round][1]);
    x[3] = static_cast<std::uint32_t>(a);
  }
  return x[y >> 1] >> (16 * (y & 1)) & 0xFFFFu;
}

/// What every voxel of the tick needs, in lanes. Local to a visit, so that no store to the bone can reach it and
/// the compiler keeps it in registers.
struct Constants {
  Float zero = set(0.0f), one = set(1.0f), half = set(0.5f), two = set(2.0f), levels = set(256.0f);
  Float least = set(0x1p-20f);  // w: never 0, so that it divides
  Float spacing, spacing_inverse, relative_spacing, radius, radius_inverse, radius2_inverse, deep2, fraction_scale;
  Integer p;                  // pristine level of a brick of one level
  Float p_levels, p_inverse;  // 256 p, and 1/(65536 p)

  Constants(const Sphere& at, const Brick& brick)
      : spacing(set(at.spacing[0])),
        spacing_inverse(set(at.spacing_inverse)),
        relative_spacing(set(at.spacing[0] * at.radius_inverse)),
        radius(set(at.radius)),
        radius_inverse(set(at.radius_inverse)),
        radius2_inverse(set(at.radius2_inverse)),
        deep2(set(at.deep2)),
        fraction_scale(set(at.fraction_scale)) {
    set_pristine(set(brick.level));
  }
  void set_pristine(Integer level) {
    p = level;
    p_levels = larger(to_float(level), one) * levels;  // an empty voxel would divide by zero
    p_inverse = one / (p_levels * levels);
  }
};

/// The brick's distances, row by row.
struct Rows {
  alignas(64) float r2[64];  // dz dz + dy dy
  alignas(64) float a2[64];  // likewise of spacing times offset; anisotropic voxels only
  Float x2, ax2;             // the same along a row
  float x2_least, x2_most;
};

template <bool isotropic>
inline void measure(const Sphere& at, const Brick& brick, Rows& rows) {
  const auto offset = [&](int first, int axis) {
    return (to_float(set(first) + index_in_row()) - set(at.fraction[axis])) * set(at.spacing[axis]);
  };
  const Float dx = offset(brick.x, 0), dy = offset(brick.y, 1), dz = offset(brick.z, 2);
  alignas(64) float x2[lanes], z2[lanes];
  rows.x2 = dx * dx;
  store(x2, rows.x2);
  store(z2, dz * dz);
  const bool beside = brick.x > 0 || brick.x < -7;
  rows.x2_most = x2[0] > x2[7] ? x2[0] : x2[7];
  rows.x2_least = !beside ? 0.0f : x2[0] < x2[7] ? x2[0] : x2[7];
  const Float y2 = dy * dy;
  for (int z = 0; z < 8; z += slabs) store(rows.r2 + 8 * z, set_slabs(z2[z], z2[z + slabs - 1]) + y2);
  if (!isotropic) {
    const Float ax = set(at.spacing[0]) * dx, ay = set(at.spacing[1]) * dy, az = set(at.spacing[2]) * dz;
    rows.ax2 = ax * ax;
    store(z2, az * az);
    const Float ay2 = ay * ay;
    for (int z = 0; z < 8; z += slabs) store(rows.a2 + 8 * z, set_slabs(z2[z], z2[z + slabs - 1]) + ay2);
  }
}

/// The units that hold something within reach, and of these the ones that are deep throughout.
struct Wanted {
  Units shallow = 0, deep = 0;
};

inline Wanted wanted_units(const Sphere& at, const Brick& brick, const Rows& rows) {
  const Float reach2 = set(at.outer2 - rows.x2_least), deep2 = set(at.deep2), most = set(rows.x2_most);
  Wanted wanted;
  for (int z = 0; z < 8; z += slabs) {
    const Float r2 = load(rows.r2 + 8 * z);
    unsigned held = rows_that_hold(brick.density + 64 * z);
    if (slabs == 2) held |= rows_that_hold(brick.density + 64 * (z + slabs - 1)) << 8;
    unsigned any = held & bits(r2 <= reach2), shallow = held & ~bits(r2 + most <= deep2);
    if (slabs == 2) {
      any = (any | any >> 8) & 0xFF;
      shallow |= shallow >> 8;
    }
    wanted.shallow |= Units{any & shallow} << (8 * (z / slabs));
    wanted.deep |= Units{any & ~shallow} << (8 * (z / slabs));
  }
  return wanted;
}

/// What the steps of the erosion hand on, unit by unit. Each step goes through all units before the next
/// begins: one voxel's arithmetic is a long chain, and only many of them side by side keep the CPU busy.
struct Steps {
  struct alignas(64) Row {
    float mass[lanes];     // that erodes [2^-16 level]
    float covered[lanes];  // before it is clamped to w
    float r2[lanes];
    float e_part[lanes];  // of e and tau within a cell of the table
    float tau_part[lanes];
    std::uint32_t cell[lanes];  // offset in the table
    float width[lanes];         // w s/R
    float f[lanes];             // first y of f = y^k
    std::uint32_t unit;
    alignas(64) float depth[lanes];  // R - r; the rest as a rule not needed
    float p_inverse[lanes];
    float relative_spacing[lanes];  // s/R
    float e[lanes];
  } row[units];
  alignas(64) std::int32_t u[units][lanes];  // by unit, not by position in the list
};

/// First byte of a unit in a tile.
inline unsigned tile_offset(unsigned unit) { return slabs == 1 ? 8 * unit : 128 * (unit >> 3) + 8 * (unit & 7); }

/// Mass by lane, summed by y and by z.
struct Mass {
  Integer by_y[8], by_z[8 / slabs], faint;

  Mass() : faint(set(0)) {
    for (Integer& each : by_y) each = set(0);
    for (Integer& each : by_z) each = set(0);
  }
  void add(unsigned unit, Integer mass) {
    by_y[unit & 7] = by_y[unit & 7] + mass;
    by_z[unit >> 3] = by_z[unit >> 3] + mass;
  }
};

inline Float squared_distance(const float* rows, Float x2, unsigned unit) {
  const float* row = rows + tile_offset(unit) / 8;
  return set_slabs(row[0], row[8 * (slabs - 1)]) + x2;
}

/// Mass inside the sphere of a unit at its boundary, and what its erosion needs of the geometry.
/// `plain`: the brick has one pristine level, not a faint one, and f is a power.
template <bool layer, bool isotropic, bool summing, bool eroding, bool plain>
inline void meet(const Sphere& at, const Brick& brick, const Rows& rows, Constants& c, int i, unsigned unit,
                 Steps& steps, Mass& sum) {
  const Integer q = load_row(brick.density + tile_offset(unit));

  // Distance, and the covered fraction w of each voxel.
  const Float r2 = squared_distance(rows.r2, rows.x2, unit);
  const Float r = square_root(r2);
  Float s_inverse = c.spacing_inverse, relative_spacing = c.relative_spacing;
  if (!isotropic) {
    const Float a = square_root(squared_distance(rows.a2, rows.ax2, unit));
    const Mask off_centre = r > c.zero;
    relative_spacing = select(off_centre, a / select(off_centre, r, c.one), c.spacing) * c.radius_inverse;
    s_inverse = select(off_centre, r / select(off_centre, a, c.one), s_inverse);
  }
  const Float depth = c.radius - r;
  const Float covered = depth * s_inverse + c.half;
  const Float w = smaller(larger(covered, c.least), c.one);

  // Mass inside the sphere [1/256 level]; in `layer` what is left lies outside the sphere first.
  Integer mass;
  if (layer) {
    if (!plain && brick.pristine) c.set_pristine(load_row(brick.pristine + tile_offset(unit)));
    mass = positive(times256(q) - truncate(c.p_levels * (c.one - w) + c.half));
  } else {
    mass = truncate(to_float(q) * (w * c.levels) + c.half);
  }
  if (summing) {
    sum.add(unit, mass);
    if (layer && !plain && brick.faint) sum.faint = sum.faint + only(set(32) > c.p, mass);
  }

  if (eroding) steps.row[i].unit = unit;
  if (eroding && layer) {
    auto& step = steps.row[i];
    store(step.mass, to_float(mass) * c.levels);
    store(step.covered, covered);
    store(step.r2, r2);
    if (!plain) store(step.p_inverse, c.p_inverse);
    if (!isotropic) store(step.relative_spacing, relative_spacing);
    if (!isotropic || !plain) store(step.depth, depth);
  }
  if (eroding && !layer) {  // a uniform voxel erodes whole, at f(r/R)
    const Float x2 = r2 * c.radius2_inverse;
    Float f = c.one;
    if (at.shape == shape_linear) f = larger(c.one - r * c.radius_inverse, c.zero);
    if (at.shape == shape_power) f = c.one - x2;
    store(steps.row[i].mass, select(mass > set(0), to_float(q) * set(65536.0f), c.zero));
    store(steps.row[i].f, select(x2 > c.one, c.zero, f));
  }
}

/// A unit of deep voxels: whole, and as a rule without a square root.
template <bool layer, bool summing, bool eroding>
inline void meet_deep(const Sphere& at, const Brick& brick, const Rows& rows, const Constants& c, int i, unsigned unit,
                      Steps& steps, Mass& sum) {
  const Integer q = load_row(brick.density + tile_offset(unit));
  if (summing) {
    sum.add(unit, times256(q));
    if (layer && brick.faint) {
      const Integer p = brick.pristine ? load_row(brick.pristine + tile_offset(unit)) : c.p;
      sum.faint = sum.faint + only(set(32) > p, times256(q));
    }
  }
  if (eroding) {
    const Float r2 = squared_distance(rows.r2, rows.x2, unit);
    Float f = c.one;
    if (at.shape == shape_power) f = c.one - r2 * c.radius2_inverse;
    if (at.shape == shape_linear) {
      const Float r = square_root(r2);
      f = layer ? (c.radius - r) * c.radius_inverse : c.one - r * c.radius_inverse;
    }
    steps.row[i].unit = unit;
    store(steps.row[i].mass, to_float(q) * set(65536.0f));
    store(steps.row[i].f, f);
  }
}

/// The fraction left tau and the depth e of the outer face of the covered part (`layer`); their cell in the table of G.
template <bool isotropic, bool plain>
inline void find_cells(const Constants& c, Steps& steps, int count) {
  const Float rows_per_voxel = set(8.0f), columns_per_unit = set(40.0f), last_row = set(23.0f), last_column = set(39.0f);
  const Float row_size = set(160.0f), cell_size = set(4.0f), deepest = set(3.0f);
  for (int i = 0; i < count; ++i) {
    auto& step = steps.row[i];
    const Float covered = load(step.covered), w = smaller(larger(covered, c.least), c.one);
    const Float p_inverse = plain ? c.p_inverse : load(step.p_inverse);
    const Float tau = smaller((load(step.mass) * p_inverse) / w, c.one);
    const Float e = larger(covered - c.one, c.zero);
    const Float te = (isotropic ? smaller(e, deepest) : e) * rows_per_voxel, tt = tau * columns_per_unit;
    const Float row = smaller(to_float(truncate(te)), last_row), column = smaller(to_float(truncate(tt)), last_column);
    store(step.e_part, te - row);
    store(step.tau_part, tt - column);
    store(step.cell, truncate(row * row_size + column * cell_size));
    store(step.width, w * (isotropic ? c.relative_spacing : load(step.relative_spacing)));
    if (!isotropic) store(step.e, e);
  }
}

/// f, or y of f = y^k, at the effective depth delta = w s/R G(e, tau) of what the voxels hold (`layer`); G bilinear.
template <bool isotropic>
inline void find_f(const Sphere& at, const Constants& c, Steps& steps, int count) {
  const Float deepest = set(3.0f);
  const float* depth_table = at.depth;
  const bool power = at.shape == shape_power;
  for (int i = 0; i < count; ++i) {
    const Float fe = load(steps.row[i].e_part), ft = load(steps.row[i].tau_part);
    Float low, low_rise, high, high_rise;
    look_up(depth_table, steps.row[i].cell, low, low_rise, high, high_rise);
    const Float lo = low + low_rise * ft, hi = high + high_rise * ft;
    Float delta = load(steps.row[i].width) * (lo + (hi - lo) * fe);
    if (!isotropic)
      delta = select(deepest <= load(steps.row[i].e), load(steps.row[i].depth) * c.radius_inverse, delta);
    const Float r2 = load(steps.row[i].r2);
    const Mask deep = r2 <= c.deep2;
    store(steps.row[i].f, power ? select(deep, c.one - r2 * c.radius2_inverse, delta * (c.two - delta))
                            : select(deep, load(steps.row[i].depth) * c.radius_inverse, delta));
  }
}

inline void raise(const Sphere& at, Steps& steps, int count) {  // y to y^k
  for (int i = 0; i < count; ++i) {
    if (at.whole == 0) {
      for (float& y : steps.row[i].f) y = static_cast<float>(at.power(static_cast<double>(y), at.exponent));
    } else {
      const Float y = load(steps.row[i].f);
      Float f = y;
      for (int k = 1; k < at.whole; ++k) f = f * y;
      store(steps.row[i].f, f);
    }
  }
}

/// U of the slabs that the units lie in.
inline void draw_slabs(const Sphere& at, const Brick& brick, Units wanted, Steps& steps) {
  Units by_slab = wanted | wanted >> 4;
  by_slab |= by_slab >> 2;
  by_slab = (by_slab | by_slab >> 1) & 0x0101010101010101u;
  for (; by_slab; by_slab &= by_slab - 1) {
    const unsigned z = lowest(by_slab) / 8;
    const std::uint32_t column = brick.column + slabs * z * brick.columns_in_slab;
    const Draw u = draw(at.draws, column, brick.columns_in_slab);
    for (int i = 0; i < 4; ++i) {
      store(steps.u[8 * z + 2 * i], low16(u.word[i]));
      store(steps.u[8 * z + 2 * i + 1], high16(u.word[i]));
    }
  }
}

/// Draws V where the low 16 bits of lambda + U are all ones: whether the rest of lambda carries.
BURRLAB_RARE Integer settle_ties(const Sphere& at, const Brick& brick, unsigned unit, Float scaled, Integer lost,
                                 unsigned tie) {
  const int z = slabs * static_cast<int>(unit >> 3), y = unit & 7;
  const Float rest = (scaled - to_float(truncate(scaled))) * set(65536.0f) + set(0.5f);
  alignas(64) std::int32_t each[lanes], low[lanes];
  store(each, lost);
  store(low, truncate(rest));
  for (; tie; tie &= tie - 1) {
    const int lane = static_cast<int>(lowest(tie));
    const std::uint32_t column = brick.column + static_cast<std::uint32_t>(z + lane / 8) * brick.columns_in_slab +
                                 static_cast<std::uint32_t>(lane % 8);
    each[lane] += draw_one(at, column, y, 1) < static_cast<std::uint32_t>(low[lane]);
  }
  return load(each);
}

/// Takes from every unit the loss that its expected loss lambda and U give.
inline void lose(const Sphere& at, const Brick& brick, const Constants& c, const Steps& steps, int count) {
  const Float c1 = set(0.49999714f), c2 = set(0.16652727f), c3 = set(0.03972289f);
  const int doublings = at.doublings;
  for (int i = 0; i < count; ++i) {
    const auto& step = steps.row[i];
    const Float y = c.fraction_scale * load(step.f);
    Float eroded = y * (c.one - y * (c1 - y * (c2 - y * c3)));  // 1 - exp(-a f)
    for (int k = 0; k < doublings; ++k) eroded = eroded * (c.two - eroded);
    const Float scaled = load(step.mass) * eroded;
    const Integer sum = truncate(scaled) + load(steps.u[step.unit]);
    Integer lost = high16(sum);
    if (const unsigned tie = bits(low16(sum) == set(0xFFFF)))
      lost = settle_ties(at, brick, step.unit, scaled, lost, tie);
    take_from_row(brick.density + tile_offset(step.unit), lost);
  }
}

inline void add_up(const Mass& sum, bool faint, Sums& sums) {
  Integer total = sum.by_y[0], above = sum.by_y[7], by_y = above, by_z = set(0);
  for (int y = 6; y > 0; --y) {  // sum of y M as a sum of sums from above
    above = above + sum.by_y[y];
    by_y = by_y + above;
  }
  total = total + above;
  above = set(0);
  for (int z = 8 / slabs - 1; z > 0; --z) {
    above = above + sum.by_z[z];
    by_z = by_z + above;
  }
  std::int32_t each[4];
  horizontal_sums(total, times_index(total), by_y, by_z, each);
  sums.mass = each[0];
  sums.x = each[1];
  sums.y = each[2];
  sums.z = slabs * each[3] + (slabs == 2 ? upper_sum(total) : 0);
  if (faint) {
    horizontal_sums(sum.faint, sum.faint, sum.faint, sum.faint, each);
    sums.faint = each[0];
  }
}

template <bool layer, bool isotropic, bool summing, bool eroding>
void visit(const Sphere& at, const Brick& brick, Sums& sums) {
  Rows rows;
  measure<isotropic>(at, brick, rows);
  const Wanted wanted = wanted_units(at, brick, rows);
  Constants c(at, brick);
  Steps steps;
  Mass sum;
  int count = 0;
  const bool plain = layer && !brick.pristine && !brick.faint && at.shape == shape_power;
  if (plain) {
    for (Units left = wanted.shallow; left; left &= left - 1)
      meet<layer, isotropic, summing, eroding, true>(at, brick, rows, c, count++, lowest(left), steps, sum);
  } else {
    for (Units left = wanted.shallow; left; left &= left - 1)
      meet<layer, isotropic, summing, eroding, false>(at, brick, rows, c, count++, lowest(left), steps, sum);
  }
  const int shallow = count;
  for (Units left = wanted.deep; left; left &= left - 1)
    meet_deep<layer, summing, eroding>(at, brick, rows, c, count++, lowest(left), steps, sum);
  if (summing) add_up(sum, layer && brick.faint, sums);

  if (eroding) {
    if (layer && at.shape == shape_constant) {
      for (int i = 0; i < shallow; ++i) store(steps.row[i].f, c.one);
    } else if (layer) {
      if (plain)
        find_cells<isotropic, true>(c, steps, shallow);
      else
        find_cells<isotropic, false>(c, steps, shallow);
      find_f<isotropic>(at, c, steps, shallow);
    }
    if (at.shape == shape_power && at.whole != 1) raise(at, steps, count);
    draw_slabs(at, brick, wanted.shallow | wanted.deep, steps);
    lose(at, brick, c, steps, count);
    sum_levels(brick.density, sums);
  }
}

void draw_field(const Draws& draws, std::uint32_t column, std::uint32_t columns_in_slab, std::uint16_t* out) {
  const Draw u = draw(draws, column, columns_in_slab);
  for (int y = 0; y < 8; ++y) {
    alignas(64) std::int32_t row[lanes];
    store(row, y & 1 ? high16(u.word[y >> 1]) : low16(u.word[y >> 1]));
    for (int i = 0; i < lanes; ++i) out[64 * (i / 8) + 8 * y + i % 8] = static_cast<std::uint16_t>(row[i]);
  }
}

}  // namespace

#define BURRLAB_VISITS(summing, eroding)                                                     \
  {                                                                                          \
    {visit<false, false, summing, eroding>, visit<false, true, summing, eroding>},           \
        {visit<true, false, summing, eroding>, visit<true, true, summing, eroding>},         \
  }
#define BURRLAB_KERNEL(name)                                                                              \
  {                                                                                                       \
    name, slabs, {BURRLAB_VISITS(true, false), BURRLAB_VISITS(false, true), BURRLAB_VISITS(true, true)}, draw_field \
  }

}  // namespace burrlab::kernel
