// Sixteen lanes in AVX-512 registers: the rows (z, y) and (z + 1, y) of a brick; see lanes_scalar.hpp.
#pragma once

#include <immintrin.h>

#include "kernel.hpp"
#include "shared_rows_x86.hpp"

namespace burrlab::kernel {
namespace {

constexpr int lanes = 16;

struct Float {
  __m512 v;
};
struct Integer {
  __m512i v;
};
struct Mask {
  __mmask16 v;
};

inline Float set(float a) { return {_mm512_set1_ps(a)}; }
inline Integer set(int a) { return {_mm512_set1_epi32(a)}; }
inline Float set_slabs(float a, float b) {
  return {_mm512_mask_broadcastss_ps(_mm512_set1_ps(a), 0xFF00, _mm_set_ss(b))};
}
inline Float load(const float* a) { return {_mm512_load_ps(a)}; }
inline void store(float* to, Float a) { _mm512_store_ps(to, a.v); }
inline void store(std::int32_t* to, Integer a) { _mm512_store_si512(to, a.v); }
inline void store(std::uint32_t* to, Integer a) { store(reinterpret_cast<std::int32_t*>(to), a); }
inline Integer load(const std::int32_t* a) { return {_mm512_load_si512(a)}; }
inline Integer index_in_row() { return {_mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7)}; }

inline Float operator+(Float a, Float b) { return {_mm512_add_ps(a.v, b.v)}; }
inline Float operator-(Float a, Float b) { return {_mm512_sub_ps(a.v, b.v)}; }
inline Float operator*(Float a, Float b) { return {_mm512_mul_ps(a.v, b.v)}; }
inline Float operator/(Float a, Float b) { return {_mm512_div_ps(a.v, b.v)}; }
inline Float square_root(Float a) { return {_mm512_sqrt_ps(a.v)}; }
inline Float smaller(Float a, Float b) { return {_mm512_min_ps(a.v, b.v)}; }
inline Float larger(Float a, Float b) { return {_mm512_max_ps(a.v, b.v)}; }
inline Mask operator<=(Float a, Float b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_LE_OQ)}; }
inline Mask operator>(Float a, Float b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_GT_OQ)}; }
inline Float select(Mask m, Float a, Float b) { return {_mm512_mask_blend_ps(m.v, b.v, a.v)}; }

inline Integer operator+(Integer a, Integer b) { return {_mm512_add_epi32(a.v, b.v)}; }
inline Integer operator-(Integer a, Integer b) { return {_mm512_sub_epi32(a.v, b.v)}; }
inline Mask operator>(Integer a, Integer b) { return {_mm512_cmpgt_epi32_mask(a.v, b.v)}; }
inline Mask operator==(Integer a, Integer b) { return {_mm512_cmpeq_epi32_mask(a.v, b.v)}; }
inline Integer times256(Integer a) { return {_mm512_slli_epi32(a.v, 8)}; }
inline Integer low16(Integer a) { return {_mm512_and_si512(a.v, _mm512_set1_epi32(0xFFFF))}; }
inline Integer high16(Integer a) { return {_mm512_srli_epi32(a.v, 16)}; }
inline Integer positive(Integer a) { return {_mm512_max_epi32(a.v, _mm512_setzero_si512())}; }
inline Integer only(Mask m, Integer a) { return {_mm512_maskz_mov_epi32(m.v, a.v)}; }
inline Integer plus_one_where(Mask m, Integer a) {
  return {_mm512_mask_add_epi32(a.v, m.v, a.v, _mm512_set1_epi32(1))};
}

inline Float to_float(Integer a) { return {_mm512_cvtepi32_ps(a.v)}; }
inline Integer truncate(Float a) { return {_mm512_cvttps_epi32(a.v)}; }
inline unsigned bits(Mask m) { return m.v; }

inline Integer times_index(Integer a) { return {_mm512_mullo_epi32(a.v, index_in_row().v)}; }
inline void horizontal_sums(Integer a, Integer b, Integer c, Integer d, std::int32_t* out) {
  const auto halves = [](Integer x) {
    return _mm256_add_epi32(_mm512_castsi512_si256(x.v), _mm512_extracti64x4_epi64(x.v, 1));
  };
  const __m256i pairs =
      _mm256_hadd_epi32(_mm256_hadd_epi32(halves(a), halves(b)), _mm256_hadd_epi32(halves(c), halves(d)));
  _mm_storeu_si128(reinterpret_cast<__m128i*>(out),
                   _mm_add_epi32(_mm256_castsi256_si128(pairs), _mm256_extracti128_si256(pairs, 1)));
}
/// The sum over the lanes of the upper row.
inline std::int32_t upper_sum(Integer a) { return _mm512_mask_reduce_add_epi32(0xFF00, a.v); }

/// The levels of both rows.
inline __m128i load_bytes(const std::uint8_t* row) {
  const __m128i low = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(row));
  return _mm_castpd_si128(_mm_loadh_pd(_mm_castsi128_pd(low), reinterpret_cast<const double*>(row + 64)));
}
inline Integer load_row(const std::uint8_t* row) { return {_mm512_cvtepu8_epi32(load_bytes(row))}; }
/// Takes 0..255 levels from each voxel of both rows.
inline void take_from_row(std::uint8_t* row, Integer loss) {
  const __m128i left = _mm_sub_epi8(load_bytes(row), _mm512_cvtepi32_epi8(loss.v));
  store_low_row(row, left);
  store_high_row(row + 64, left);
}
inline unsigned rows_that_hold(const std::uint8_t* slab) {
  const __m512i rows = _mm512_load_si512(slab);
  return _mm512_test_epi64_mask(rows, rows);
}

inline Integer cell_offset(Integer row, Integer column) {
  const __m512i both = _mm512_or_si512(row.v, _mm512_slli_epi32(column.v, 16));
  return {_mm512_madd_epi16(both, _mm512_set1_epi32(depth_cell << 16 | depth_row))};
}
inline void look_up(const float* quads, const std::uint32_t* i, Float& a, Float& b, Float& c, Float& d) {
  const auto four = [&](int k) {
    __m512 r = _mm512_castps128_ps512(_mm_load_ps(quads + i[k]));
    r = _mm512_insertf32x4(r, _mm_load_ps(quads + i[k + 4]), 1);
    r = _mm512_insertf32x4(r, _mm_load_ps(quads + i[k + 8]), 2);
    return _mm512_insertf32x4(r, _mm_load_ps(quads + i[k + 12]), 3);
  };
  const __m512 r0 = four(0), r1 = four(1), r2 = four(2), r3 = four(3);
  const __m512 t0 = _mm512_unpacklo_ps(r0, r1), t1 = _mm512_unpackhi_ps(r0, r1);
  const __m512 t2 = _mm512_unpacklo_ps(r2, r3), t3 = _mm512_unpackhi_ps(r2, r3);
  a.v = _mm512_shuffle_ps(t0, t2, 0x44);
  b.v = _mm512_shuffle_ps(t0, t2, 0xEE);
  c.v = _mm512_shuffle_ps(t1, t3, 0x44);
  d.v = _mm512_shuffle_ps(t1, t3, 0xEE);
}

/// 32-bit counter words of 2 x 8 columns as two vectors of 64-bit lanes, even and odd columns. The lanes'
/// upper halves mean nothing, so a product needs no shuffle.
struct Words {
  __m512i even, odd;
};
inline Words first_words(std::uint32_t column, std::uint32_t column_above) {
  const __m512i at = _mm512_mask_set1_epi64(_mm512_set1_epi64(column), 0xF0, column_above);
  return {_mm512_add_epi32(at, _mm512_setr_epi64(0, 2, 4, 6, 0, 2, 4, 6)),
          _mm512_add_epi32(at, _mm512_setr_epi64(1, 3, 5, 7, 1, 3, 5, 7))};
}
inline Words all_words(std::uint64_t a) {
  const __m512i v = _mm512_set1_epi64(static_cast<long long>(a));
  return {v, v};
}
inline Words product(Words a, Words b) {
  return {_mm512_mul_epu32(a.even, b.even), _mm512_mul_epu32(a.odd, b.odd)};
}
inline Words high(Words a) { return {_mm512_srli_epi64(a.even, 32), _mm512_srli_epi64(a.odd, 32)}; }
inline Words operator^(Words a, Words b) {
  return {_mm512_xor_si512(a.even, b.even), _mm512_xor_si512(a.odd, b.odd)};
}
inline Words exclusive_or(Words a, Words b, Words c) {
  constexpr int odd = 0x96;  // truth table of a ^ b ^ c
  return {_mm512_ternarylogic_epi64(a.even, b.even, c.even, odd),
          _mm512_ternarylogic_epi64(a.odd, b.odd, c.odd, odd)};
}
inline Integer in_order(Words a) {
  return {_mm512_mask_blend_epi32(0xAAAA, a.even, _mm512_slli_epi64(a.odd, 32))};
}

struct Wide {
  __m512i v;
};
inline Wide wide_zero() { return {_mm512_setzero_si512()}; }
inline Wide add_product(Wide sum, Integer a, Integer b) {
  const __m512i odd = _mm512_mul_epu32(_mm512_srli_epi64(a.v, 32), _mm512_srli_epi64(b.v, 32));
  return {_mm512_add_epi64(sum.v, _mm512_add_epi64(_mm512_mul_epu32(a.v, b.v), odd))};
}
inline std::int64_t total(Wide a) { return _mm512_reduce_add_epi64(a.v); }

inline Integer pick(const std::int32_t* table, const std::uint8_t* numbers, bool few) {
  const __m512i n = load_row(numbers).v;
  const __m512i first = _mm512_loadu_si512(table);
  if (few) return {_mm512_permutexvar_epi32(n, first)};
  const __m512i low = _mm512_permutex2var_epi32(first, n, _mm512_loadu_si512(table + 16));
  const __m512i high =
      _mm512_permutex2var_epi32(_mm512_loadu_si512(table + 32), n, _mm512_loadu_si512(table + 48));
  return {_mm512_mask_blend_epi32(_mm512_test_epi32_mask(n, _mm512_set1_epi32(32)), low, high)};
}
inline Float pick(const float* table, const std::uint8_t* numbers, bool few) {
  return {_mm512_castsi512_ps(pick(reinterpret_cast<const std::int32_t*>(table), numbers, few).v)};
}

inline std::uint32_t sum_where(const std::uint8_t* tile, const std::uint8_t* numbers, std::uint8_t number,
                               const Slabs& slabs) {
  const __m512i which = _mm512_set1_epi8(static_cast<char>(number)), zero = _mm512_setzero_si512();
  __m512i sum = zero;
  for (int i = 0; i < slabs.count; ++i) {
    const unsigned at = slabs.at[i];
    const __mmask64 here = _mm512_cmpeq_epi8_mask(_mm512_load_si512(numbers + at), which);
    sum = _mm512_add_epi64(sum, _mm512_sad_epu8(_mm512_maskz_loadu_epi8(here, tile + at), zero));
  }
  return static_cast<std::uint32_t>(total({sum}));
}

inline void sum_levels(const std::uint8_t* tile, Sums& sums) {
  const __m512i zero = _mm512_setzero_si512(), weight = _mm512_set1_epi64(0x0706050403020100);
  __m512i rows = zero, z = zero, x = zero;  // by row, 64-bit lanes; x in 16-bit lanes, at most 8 * 13 * 255
  for (int slab = 7; slab >= 0; --slab) {
    const __m512i a = _mm512_load_si512(tile + 64 * slab);
    rows = _mm512_add_epi64(rows, _mm512_sad_epu8(a, zero));
    x = _mm512_add_epi16(x, _mm512_maddubs_epi16(a, weight));
    if (slab > 0) z = _mm512_add_epi64(z, rows);  // sum of z q as a sum of sums from above
  }
  const __m512i y = _mm512_mullo_epi64(rows, _mm512_setr_epi64(0, 1, 2, 3, 4, 5, 6, 7));
  sums.after_mass = static_cast<std::uint32_t>(_mm512_reduce_add_epi64(rows));
  sums.after_x =
      static_cast<std::uint32_t>(_mm512_reduce_add_epi32(_mm512_madd_epi16(x, _mm512_set1_epi16(1))));
  sums.after_y = static_cast<std::uint32_t>(_mm512_reduce_add_epi64(y));
  sums.after_z = static_cast<std::uint32_t>(_mm512_reduce_add_epi64(z));
}

}  // namespace
}  // namespace burrlab::kernel
