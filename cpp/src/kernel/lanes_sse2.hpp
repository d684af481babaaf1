// Eight lanes in pairs of SSE2 registers, which every x86-64 has: a row of a brick; see lanes_scalar.hpp.
#pragma once

#include <emmintrin.h>

#include "kernel.hpp"
#include "shared_rows_x86.hpp"

namespace burrlab::kernel {
namespace {

struct Float {
  __m128 a, b;
};
struct Integer {
  __m128i a, b;
};
struct Mask {
  __m128 a, b;
};

inline Float set(float a) { return {_mm_set1_ps(a), _mm_set1_ps(a)}; }
inline Integer set(int a) { return {_mm_set1_epi32(a), _mm_set1_epi32(a)}; }
inline Float load(const float* p) { return {_mm_load_ps(p), _mm_load_ps(p + 4)}; }
inline void store(float* to, Float x) { _mm_store_ps(to, x.a), _mm_store_ps(to + 4, x.b); }
inline void store(std::int32_t* to, Integer x) {
  _mm_store_si128(reinterpret_cast<__m128i*>(to), x.a);
  _mm_store_si128(reinterpret_cast<__m128i*>(to) + 1, x.b);
}
inline Integer load(const std::int32_t* p) {
  return {_mm_load_si128(reinterpret_cast<const __m128i*>(p)),
          _mm_load_si128(reinterpret_cast<const __m128i*>(p) + 1)};
}
inline Integer index_in_row() { return {_mm_setr_epi32(0, 1, 2, 3), _mm_setr_epi32(4, 5, 6, 7)}; }

inline Float operator+(Float x, Float y) { return {_mm_add_ps(x.a, y.a), _mm_add_ps(x.b, y.b)}; }
inline Float operator-(Float x, Float y) { return {_mm_sub_ps(x.a, y.a), _mm_sub_ps(x.b, y.b)}; }
inline Float operator*(Float x, Float y) { return {_mm_mul_ps(x.a, y.a), _mm_mul_ps(x.b, y.b)}; }
inline Float operator/(Float x, Float y) { return {_mm_div_ps(x.a, y.a), _mm_div_ps(x.b, y.b)}; }
inline Float square_root(Float x) { return {_mm_sqrt_ps(x.a), _mm_sqrt_ps(x.b)}; }
inline Float smaller(Float x, Float y) { return {_mm_min_ps(x.a, y.a), _mm_min_ps(x.b, y.b)}; }
inline Float larger(Float x, Float y) { return {_mm_max_ps(x.a, y.a), _mm_max_ps(x.b, y.b)}; }
inline Mask operator<=(Float x, Float y) { return {_mm_cmple_ps(x.a, y.a), _mm_cmple_ps(x.b, y.b)}; }
inline Mask operator>(Float x, Float y) { return {_mm_cmpgt_ps(x.a, y.a), _mm_cmpgt_ps(x.b, y.b)}; }
inline __m128 choose(__m128 m, __m128 x, __m128 y) {
  return _mm_or_ps(_mm_and_ps(m, x), _mm_andnot_ps(m, y));
}
inline Float select(Mask m, Float x, Float y) { return {choose(m.a, x.a, y.a), choose(m.b, x.b, y.b)}; }

inline Integer operator+(Integer x, Integer y) { return {_mm_add_epi32(x.a, y.a), _mm_add_epi32(x.b, y.b)}; }
inline Integer operator-(Integer x, Integer y) { return {_mm_sub_epi32(x.a, y.a), _mm_sub_epi32(x.b, y.b)}; }
inline Mask operator>(Integer x, Integer y) {
  return {_mm_castsi128_ps(_mm_cmpgt_epi32(x.a, y.a)), _mm_castsi128_ps(_mm_cmpgt_epi32(x.b, y.b))};
}
inline Mask operator==(Integer x, Integer y) {
  return {_mm_castsi128_ps(_mm_cmpeq_epi32(x.a, y.a)), _mm_castsi128_ps(_mm_cmpeq_epi32(x.b, y.b))};
}
inline Integer times256(Integer x) { return {_mm_slli_epi32(x.a, 8), _mm_slli_epi32(x.b, 8)}; }
inline Integer low16(Integer x) {
  const __m128i mask = _mm_set1_epi32(0xFFFF);
  return {_mm_and_si128(x.a, mask), _mm_and_si128(x.b, mask)};
}
inline Integer high16(Integer x) { return {_mm_srli_epi32(x.a, 16), _mm_srli_epi32(x.b, 16)}; }
inline Integer only(Mask m, Integer x) {
  return {_mm_and_si128(_mm_castps_si128(m.a), x.a), _mm_and_si128(_mm_castps_si128(m.b), x.b)};
}
inline Integer positive(Integer x) { return only(x > set(0), x); }
inline Integer plus_one_where(Mask m, Integer x) {
  return {_mm_sub_epi32(x.a, _mm_castps_si128(m.a)), _mm_sub_epi32(x.b, _mm_castps_si128(m.b))};
}

inline Float to_float(Integer x) { return {_mm_cvtepi32_ps(x.a), _mm_cvtepi32_ps(x.b)}; }
inline Integer truncate(Float x) { return {_mm_cvttps_epi32(x.a), _mm_cvttps_epi32(x.b)}; }
inline unsigned bits(Mask m) {
  return static_cast<unsigned>(_mm_movemask_ps(m.a) | _mm_movemask_ps(m.b) << 4);
}

inline Integer times_index(Integer a) {
  const auto bit = [](__m128i lanes_with, __m128i x) { return _mm_and_si128(lanes_with, x); };
  const __m128i odd = _mm_set_epi32(-1, 0, -1, 0), upper = _mm_set_epi32(-1, -1, 0, 0);
  const auto times = [&](__m128i x) {  // 0..3
    return _mm_add_epi32(bit(odd, x), _mm_slli_epi32(bit(upper, x), 1));
  };
  return {times(a.a), _mm_add_epi32(times(a.b), _mm_slli_epi32(a.b, 2))};
}
inline void horizontal_sums(Integer a, Integer b, Integer c, Integer d, std::int32_t* out) {
  const auto halves = [](Integer x) { return _mm_add_epi32(x.a, x.b); };
  const auto pairs = [](__m128i x, __m128i y) {
    return _mm_add_epi32(_mm_unpacklo_epi32(x, y), _mm_unpackhi_epi32(x, y));
  };
  const __m128i ab = pairs(halves(a), halves(b)), cd = pairs(halves(c), halves(d));
  _mm_storeu_si128(reinterpret_cast<__m128i*>(out),
                   _mm_add_epi32(_mm_unpacklo_epi64(ab, cd), _mm_unpackhi_epi64(ab, cd)));
}

inline Integer load_row(const std::uint8_t* row) {
  const __m128i zero = _mm_setzero_si128();
  const __m128i words = _mm_unpacklo_epi8(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(row)), zero);
  return {_mm_unpacklo_epi16(words, zero), _mm_unpackhi_epi16(words, zero)};
}
inline void take_from_row(std::uint8_t* row, Integer loss) {
  const __m128i words = _mm_packs_epi32(loss.a, loss.b);
  const __m128i levels = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(row));
  const __m128i left = _mm_sub_epi8(levels, _mm_packus_epi16(words, words));
  store_low_row(row, left);
}
inline unsigned rows_that_hold(const std::uint8_t* slab) {
  unsigned held = 0;
  for (int pair = 0; pair < 4; ++pair) {
    const __m128i rows = _mm_load_si128(reinterpret_cast<const __m128i*>(slab) + pair);
    const auto empty = static_cast<unsigned>(_mm_movemask_epi8(_mm_cmpeq_epi8(rows, _mm_setzero_si128())));
    held |= (((empty & 0xFF) != 0xFF) | ((empty >> 8) != 0xFF) << 1) << (2 * pair);
  }
  return held;
}

inline Integer cell_offset(Integer row, Integer column) {
  const auto offset = [](__m128i r, __m128i c) {
    return _mm_madd_epi16(_mm_or_si128(r, _mm_slli_epi32(c, 16)),
                          _mm_set1_epi32(depth_cell << 16 | depth_row));
  };
  return {offset(row.a, column.a), offset(row.b, column.b)};
}
inline void look_up(const float* quads, const std::uint32_t* i, Float& a, Float& b, Float& c, Float& d) {
  a.a = _mm_load_ps(quads + i[0]), b.a = _mm_load_ps(quads + i[1]);
  c.a = _mm_load_ps(quads + i[2]), d.a = _mm_load_ps(quads + i[3]);
  a.b = _mm_load_ps(quads + i[4]), b.b = _mm_load_ps(quads + i[5]);
  c.b = _mm_load_ps(quads + i[6]), d.b = _mm_load_ps(quads + i[7]);
  _MM_TRANSPOSE4_PS(a.a, b.a, c.a, d.a);
  _MM_TRANSPOSE4_PS(a.b, b.b, c.b, d.b);
}

/// 32-bit counter words of eight columns in 64-bit lanes, 0 2, 4 6, 1 3, 5 7. The lanes' upper halves mean
/// nothing, so a product needs no shuffle.
struct Words {
  __m128i v[4];
};
inline Words first_words(std::uint32_t column) {
  const __m128i at = _mm_set1_epi64x(column);
  return {{_mm_add_epi32(at, _mm_set_epi64x(2, 0)), _mm_add_epi32(at, _mm_set_epi64x(6, 4)),
           _mm_add_epi32(at, _mm_set_epi64x(3, 1)), _mm_add_epi32(at, _mm_set_epi64x(7, 5))}};
}
inline Words all_words(std::uint64_t a) {
  const __m128i v = _mm_set1_epi64x(static_cast<long long>(a));
  return {{v, v, v, v}};
}
inline Words product(Words a, Words b) {
  for (int i = 0; i < 4; ++i) a.v[i] = _mm_mul_epu32(a.v[i], b.v[i]);
  return a;
}
inline Words high(Words a) {
  for (__m128i& v : a.v) v = _mm_srli_epi64(v, 32);
  return a;
}
inline Words operator^(Words a, Words b) {
  for (int i = 0; i < 4; ++i) a.v[i] = _mm_xor_si128(a.v[i], b.v[i]);
  return a;
}
inline Words exclusive_or(Words a, Words b, Words c) { return a ^ b ^ c; }
inline Integer in_order(Words a) {
  const __m128i low = _mm_set1_epi64x(0xFFFFFFFF);
  return {_mm_or_si128(_mm_and_si128(a.v[0], low), _mm_slli_epi64(a.v[2], 32)),
          _mm_or_si128(_mm_and_si128(a.v[1], low), _mm_slli_epi64(a.v[3], 32))};
}

struct Wide {
  __m128i v;
};
inline Wide wide_zero() { return {_mm_setzero_si128()}; }
inline Wide add_product(Wide sum, Integer a, Integer b) {
  const auto products = [](__m128i x, __m128i y) {
    return _mm_add_epi64(_mm_mul_epu32(x, y), _mm_mul_epu32(_mm_srli_epi64(x, 32), _mm_srli_epi64(y, 32)));
  };
  return {_mm_add_epi64(sum.v, _mm_add_epi64(products(a.a, b.a), products(a.b, b.b)))};
}
inline std::int64_t total(Wide a) {
  return _mm_cvtsi128_si64(_mm_add_epi64(a.v, _mm_unpackhi_epi64(a.v, a.v)));
}

inline Integer pick(const std::int32_t* table, const std::uint8_t* numbers, bool) {
  const auto four = [&](const std::uint8_t* n) {
    return _mm_setr_epi32(table[n[0]], table[n[1]], table[n[2]], table[n[3]]);
  };
  return {four(numbers), four(numbers + 4)};
}
inline Float pick(const float* table, const std::uint8_t* numbers, bool) {
  const auto four = [&](const std::uint8_t* n) {
    return _mm_setr_ps(table[n[0]], table[n[1]], table[n[2]], table[n[3]]);
  };
  return {four(numbers), four(numbers + 4)};
}

inline std::uint32_t sum_where(const std::uint8_t* tile, const std::uint8_t* numbers, std::uint8_t number) {
  const __m128i which = _mm_set1_epi8(static_cast<char>(number)), zero = _mm_setzero_si128();
  __m128i sum = zero;
  for (unsigned at = 0; at < 512; at += 16) {
    const __m128i here =
        _mm_cmpeq_epi8(_mm_load_si128(reinterpret_cast<const __m128i*>(numbers + at)), which);
    const __m128i levels = _mm_load_si128(reinterpret_cast<const __m128i*>(tile + at));
    sum = _mm_add_epi64(sum, _mm_sad_epu8(_mm_and_si128(here, levels), zero));
  }
  return static_cast<std::uint32_t>(total({sum}));
}

inline void sum_levels(const std::uint8_t* tile, Sums& sums) {
  const __m128i zero = _mm_setzero_si128();
  __m128i rows[4] = {zero, zero, zero, zero}, x = zero, z = zero;  // by row, 64-bit lanes
  for (int slab = 7; slab >= 0; --slab) {
    for (int pair = 0; pair < 4; ++pair) {
      const __m128i q = _mm_load_si128(reinterpret_cast<const __m128i*>(tile + 64 * slab) + pair);
      rows[pair] = _mm_add_epi64(rows[pair], _mm_sad_epu8(q, zero));
      // The bits of the index x, one by one.
      const __m128i one = _mm_sad_epu8(_mm_and_si128(q, _mm_set1_epi16(-256)), zero);
      const __m128i two = _mm_sad_epu8(_mm_and_si128(q, _mm_set1_epi32(-65536)), zero);
      const __m128i four = _mm_sad_epu8(_mm_and_si128(q, _mm_set1_epi64x(-4294967296)), zero);
      x = _mm_add_epi64(x,
                        _mm_add_epi64(one, _mm_add_epi64(_mm_slli_epi64(two, 1), _mm_slli_epi64(four, 2))));
    }
    if (slab > 0) {  // sum of z q as a sum of sums from above
      z = _mm_add_epi64(z, _mm_add_epi64(_mm_add_epi64(rows[0], rows[1]), _mm_add_epi64(rows[2], rows[3])));
    }
  }
  alignas(16) std::uint64_t row[8], at_x[2], at_z[2];
  for (int pair = 0; pair < 4; ++pair) _mm_store_si128(reinterpret_cast<__m128i*>(row) + pair, rows[pair]);
  _mm_store_si128(reinterpret_cast<__m128i*>(at_x), x);
  _mm_store_si128(reinterpret_cast<__m128i*>(at_z), z);
  std::uint64_t mass = 0, y = 0;
  for (unsigned i = 0; i < 8; ++i) {
    mass += row[i];
    y += i * row[i];
  }
  sums.after_mass = static_cast<std::uint32_t>(mass);
  sums.after_x = static_cast<std::uint32_t>(at_x[0] + at_x[1]);
  sums.after_y = static_cast<std::uint32_t>(y);
  sums.after_z = static_cast<std::uint32_t>(at_z[0] + at_z[1]);
}

}  // namespace
}  // namespace burrlab::kernel
