// Eight lanes in arrays, for other CPUs: a row of a brick. Explains the functions of all lanes_*.hpp.
#pragma once

#include <math.h>

#include "kernel.hpp"
#include "shared_rows.hpp"

namespace burrlab::kernel {
namespace {

struct Float {
  float v[8];
};
struct Integer {
  std::int32_t v[8];
};
struct Mask {
  bool v[8];
};

template <class Result, class Operation>
inline Result each(Operation operation) {
  Result result;
  for (int i = 0; i < 8; ++i) result.v[i] = operation(i);
  return result;
}

inline Float set(float a) {
  return each<Float>([=](int) { return a; });
}
inline Integer set(int a) {
  return each<Integer>([=](int) { return a; });
}
inline Float load(const float* p) {
  return each<Float>([=](int i) { return p[i]; });
}
inline Integer load(const std::int32_t* p) {
  return each<Integer>([=](int i) { return p[i]; });
}
inline void store(float* to, const Float& a) {
  for (int i = 0; i < 8; ++i) to[i] = a.v[i];
}
inline void store(std::int32_t* to, const Integer& a) {
  for (int i = 0; i < 8; ++i) to[i] = a.v[i];
}
inline void store(std::uint32_t* to, const Integer& a) {
  for (int i = 0; i < 8; ++i) to[i] = static_cast<std::uint32_t>(a.v[i]);
}
inline Integer index_in_row() {
  return each<Integer>([](int i) { return i; });
}

#define BURRLAB_EACH(result, name, type, expression)        \
  inline result name(const type& a, const type& b) {        \
    return each<result>([&](int i) { return expression; }); \
  }
BURRLAB_EACH(Float, operator+, Float, a.v[i] + b.v[i])
BURRLAB_EACH(Float, operator-, Float, a.v[i] - b.v[i])
BURRLAB_EACH(Float, operator*, Float, a.v[i] * b.v[i])
BURRLAB_EACH(Float, operator/, Float, a.v[i] / b.v[i])
BURRLAB_EACH(Float, smaller, Float, a.v[i] < b.v[i] ? a.v[i] : b.v[i])
BURRLAB_EACH(Float, larger, Float, a.v[i] > b.v[i] ? a.v[i] : b.v[i])
BURRLAB_EACH(Mask, operator<=, Float, a.v[i] <= b.v[i])
BURRLAB_EACH(Mask, operator>, Float, a.v[i] > b.v[i])
BURRLAB_EACH(Integer, operator+, Integer, a.v[i] + b.v[i])
BURRLAB_EACH(Integer, operator-, Integer, a.v[i] - b.v[i])
BURRLAB_EACH(Mask, operator>, Integer, a.v[i] > b.v[i])
BURRLAB_EACH(Mask, operator==, Integer, a.v[i] == b.v[i])
#undef BURRLAB_EACH

inline Float square_root(const Float& a) {
  return each<Float>([&](int i) { return sqrtf(a.v[i]); });
}
inline Float select(const Mask& m, const Float& a, const Float& b) {
  return each<Float>([&](int i) { return m.v[i] ? a.v[i] : b.v[i]; });
}
inline Integer times256(const Integer& a) {
  return each<Integer>([&](int i) { return 256 * a.v[i]; });
}
inline Integer low16(const Integer& a) {
  return each<Integer>([&](int i) { return a.v[i] & 0xFFFF; });
}
inline Integer high16(const Integer& a) {
  return each<Integer>(
      [&](int i) { return static_cast<std::int32_t>(static_cast<std::uint32_t>(a.v[i]) >> 16); });
}
inline Integer positive(const Integer& a) {
  return each<Integer>([&](int i) { return a.v[i] > 0 ? a.v[i] : 0; });
}
inline Integer only(const Mask& m, const Integer& a) {
  return each<Integer>([&](int i) { return m.v[i] ? a.v[i] : 0; });
}
inline Integer plus_one_where(const Mask& m, const Integer& a) {
  return each<Integer>([&](int i) { return a.v[i] + m.v[i]; });
}
inline Float to_float(const Integer& a) {
  return each<Float>([&](int i) { return static_cast<float>(a.v[i]); });
}
inline Integer truncate(const Float& a) {
  return each<Integer>([&](int i) { return static_cast<std::int32_t>(a.v[i]); });
}
inline unsigned bits(const Mask& m) {
  unsigned all = 0;
  for (int i = 0; i < 8; ++i) all |= static_cast<unsigned>(m.v[i]) << i;
  return all;
}

/// Each lane times its index 0..7.
inline Integer times_index(const Integer& a) {
  return each<Integer>([&](int i) { return a.v[i] * i; });
}
/// The sums over the lanes of four vectors.
inline void horizontal_sums(const Integer& a, const Integer& b, const Integer& c, const Integer& d,
                            std::int32_t* out) {
  out[0] = out[1] = out[2] = out[3] = 0;
  for (int i = 0; i < 8; ++i) out[0] += a.v[i], out[1] += b.v[i], out[2] += c.v[i], out[3] += d.v[i];
}

/// The levels of a row.
inline Integer load_row(const std::uint8_t* row) {
  return each<Integer>([=](int i) { return static_cast<std::int32_t>(row[i]); });
}
/// Takes 0..255 levels from each voxel of a row.
inline void take_from_row(std::uint8_t* row, const Integer& loss) {
  std::uint8_t left[8];
  for (int i = 0; i < 8; ++i) left[i] = static_cast<std::uint8_t>(row[i] - loss.v[i]);
  std::uint64_t levels;
  memcpy(&levels, left, sizeof levels);
  store_row(row, levels);
}
/// One bit for each row of a slab that holds anything.
inline unsigned rows_that_hold(const std::uint8_t* slab) {
  unsigned held = 0;
  for (int i = 0; i < 64; ++i) held |= static_cast<unsigned>(slab[i] != 0) << (i / 8);
  return held;
}

/// Offset of a cell in DepthTable::cells().
inline Integer cell_offset(const Integer& row, const Integer& column) {
  return each<Integer>([&](int i) { return depth_row * row.v[i] + depth_cell * column.v[i]; });
}
/// Four consecutive floats per lane, from quads[i].
inline void look_up(const float* quads, const std::uint32_t* index, Float& a, Float& b, Float& c, Float& d) {
  for (int i = 0; i < 8; ++i) {
    const float* quad = quads + index[i];
    a.v[i] = quad[0], b.v[i] = quad[1], c.v[i] = quad[2], d.v[i] = quad[3];
  }
}

/// Counter words of eight columns; the upper halves mean nothing.
struct Words {
  std::uint64_t v[8];
};
inline Words first_words(std::uint32_t column) {
  return each<Words>([=](int i) { return std::uint64_t{column + static_cast<std::uint32_t>(i)}; });
}
inline Words all_words(std::uint64_t a) {
  return each<Words>([=](int) { return a; });
}
inline Words product(const Words& a, const Words& b) {
  return each<Words>([&](int i) { return (a.v[i] & 0xFFFFFFFFu) * (b.v[i] & 0xFFFFFFFFu); });
}
inline Words high(const Words& a) {
  return each<Words>([&](int i) { return a.v[i] >> 32; });
}
inline Words operator^(const Words& a, const Words& b) {
  return each<Words>([&](int i) { return a.v[i] ^ b.v[i]; });
}
inline Words exclusive_or(const Words& a, const Words& b, const Words& c) { return a ^ b ^ c; }
inline Integer in_order(const Words& a) {
  return each<Integer>([&](int i) { return static_cast<std::int32_t>(static_cast<std::uint32_t>(a.v[i])); });
}

/// 64-bit sums of products.
struct Wide {
  std::int64_t v;
};
inline Wide wide_zero() { return {0}; }
inline Wide add_product(Wide sum, const Integer& a, const Integer& b) {
  for (int i = 0; i < 8; ++i) sum.v += std::int64_t{a.v[i]} * b.v[i];
  return sum;
}
inline std::int64_t total(Wide a) { return a.v; }

/// The table's entry for each lane's number.
inline Float pick(const float* table, const std::uint8_t* numbers, bool) {
  return each<Float>([=](int i) { return table[numbers[i]]; });
}
inline Integer pick(const std::int32_t* table, const std::uint8_t* numbers, bool) {
  return each<Integer>([=](int i) { return table[numbers[i]]; });
}

/// Sum of the levels of a tile with this number.
inline std::uint32_t sum_where(const std::uint8_t* tile, const std::uint8_t* numbers, std::uint8_t number) {
  std::uint32_t sum = 0;
  for (unsigned at = 0; at < 512; ++at) sum += numbers[at] == number ? tile[at] : 0u;
  return sum;
}

inline void sum_levels(const std::uint8_t* tile, Sums& sums) {
  std::uint32_t mass = 0, x = 0, y = 0, z = 0;
  for (unsigned i = 0; i < 512; ++i) {
    const std::uint32_t q = tile[i];
    mass += q;
    x += q * (i & 7);
    y += q * (i >> 3 & 7);
    z += q * (i >> 6);
  }
  sums.after_mass = mass;
  sums.after_x = x;
  sums.after_y = y;
  sums.after_z = z;
}

}  // namespace
}  // namespace burrlab::kernel
