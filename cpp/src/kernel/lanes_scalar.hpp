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

/// A function of one expression for each lane i.
#define BURRLAB_EACH(result, name, parameters, expression)                   \
  inline result name parameters {                                            \
    return each<result>([&]([[maybe_unused]] int i) { return expression; }); \
  }

BURRLAB_EACH(Float, set, (float a), a)
BURRLAB_EACH(Integer, set, (int a), a)
BURRLAB_EACH(Float, load, (const float* p), p[i])
BURRLAB_EACH(Integer, load, (const std::int32_t* p), p[i])
BURRLAB_EACH(Integer, index_in_row, (), i)
inline void store(float* to, const Float& a) {
  for (int i = 0; i < 8; ++i) to[i] = a.v[i];
}
inline void store(std::int32_t* to, const Integer& a) {
  for (int i = 0; i < 8; ++i) to[i] = a.v[i];
}

BURRLAB_EACH(Float, operator+, (const Float& a, const Float& b), a.v[i] + b.v[i])
BURRLAB_EACH(Float, operator-, (const Float& a, const Float& b), a.v[i] - b.v[i])
BURRLAB_EACH(Float, operator*, (const Float& a, const Float& b), a.v[i] * b.v[i])
BURRLAB_EACH(Float, operator/, (const Float& a, const Float& b), a.v[i] / b.v[i])
BURRLAB_EACH(Float, smaller, (const Float& a, const Float& b), a.v[i] < b.v[i] ? a.v[i] : b.v[i])
BURRLAB_EACH(Float, larger, (const Float& a, const Float& b), a.v[i] > b.v[i] ? a.v[i] : b.v[i])
BURRLAB_EACH(Mask, operator<=, (const Float& a, const Float& b), a.v[i] <= b.v[i])
BURRLAB_EACH(Mask, operator>, (const Float& a, const Float& b), a.v[i] > b.v[i])
BURRLAB_EACH(Integer, operator+, (const Integer& a, const Integer& b), a.v[i] + b.v[i])
BURRLAB_EACH(Integer, operator-, (const Integer& a, const Integer& b), a.v[i] - b.v[i])
BURRLAB_EACH(Mask, operator>, (const Integer& a, const Integer& b), a.v[i] > b.v[i])
BURRLAB_EACH(Mask, operator==, (const Integer& a, const Integer& b), a.v[i] == b.v[i])

BURRLAB_EACH(Float, square_root, (const Float& a), sqrtf(a.v[i]))
BURRLAB_EACH(Float, select, (const Mask& m, const Float& a, const Float& b), m.v[i] ? a.v[i] : b.v[i])
BURRLAB_EACH(Integer, times256, (const Integer& a), 256 * a.v[i])
BURRLAB_EACH(Integer, low16, (const Integer& a), a.v[i] & 0xFFFF)
BURRLAB_EACH(Integer, high16, (const Integer& a), std::int32_t(std::uint32_t(a.v[i]) >> 16))
BURRLAB_EACH(Integer, positive, (const Integer& a), a.v[i] > 0 ? a.v[i] : 0)
BURRLAB_EACH(Integer, only, (const Mask& m, const Integer& a), m.v[i] ? a.v[i] : 0)
BURRLAB_EACH(Integer, plus_one_where, (const Mask& m, const Integer& a), a.v[i] + m.v[i])
BURRLAB_EACH(Float, to_float, (const Integer& a), static_cast<float>(a.v[i]))
BURRLAB_EACH(Integer, truncate, (const Float& a), static_cast<std::int32_t>(a.v[i]))
inline unsigned bits(const Mask& m) {
  unsigned all = 0;
  for (int i = 0; i < 8; ++i) all |= static_cast<unsigned>(m.v[i]) << i;
  return all;
}

/// Each lane times its index 0..7.
BURRLAB_EACH(Integer, times_index, (const Integer& a), a.v[i] * i)
/// The sums over the lanes of four vectors.
inline void horizontal_sums(const Integer& a, const Integer& b, const Integer& c, const Integer& d,
                            std::int32_t* out) {
  out[0] = out[1] = out[2] = out[3] = 0;
  for (int i = 0; i < 8; ++i) out[0] += a.v[i], out[1] += b.v[i], out[2] += c.v[i], out[3] += d.v[i];
}

/// The levels of a row.
BURRLAB_EACH(Integer, load_row, (const std::uint8_t* row), static_cast<std::int32_t>(row[i]))
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
BURRLAB_EACH(Integer, cell_offset, (const Integer& row, const Integer& column),
             row.v[i] * depth_row + column.v[i] * depth_cell)
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
BURRLAB_EACH(Words, first_words, (std::uint32_t column),
             std::uint64_t{column + static_cast<std::uint32_t>(i)})
BURRLAB_EACH(Words, all_words, (std::uint64_t a), a)
BURRLAB_EACH(Words, product, (const Words& a, const Words& b),
             (a.v[i] & 0xFFFFFFFFu) * (b.v[i] & 0xFFFFFFFFu))
BURRLAB_EACH(Words, high, (const Words& a), a.v[i] >> 32)
BURRLAB_EACH(Words, operator^, (const Words& a, const Words& b), a.v[i] ^ b.v[i])
BURRLAB_EACH(Words, exclusive_or, (const Words& a, const Words& b, const Words& c), a.v[i] ^ b.v[i] ^ c.v[i])
BURRLAB_EACH(Integer, in_order, (const Words& a), std::int32_t(std::uint32_t(a.v[i])))

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
BURRLAB_EACH(Float, pick, (const float* table, const std::uint8_t* numbers, bool), table[numbers[i]])
BURRLAB_EACH(Integer, pick, (const std::int32_t* table, const std::uint8_t* numbers, bool), table[numbers[i]])
#undef BURRLAB_EACH

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
