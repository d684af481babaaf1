// Eight lanes in AVX2 registers: a row of a brick; see lanes_scalar.hpp. With AVX-512 the lanes are as wide,
// and its instructions serve where they do more: sixteen lanes fill badly, as few rows meet the sphere side
// by side.
#pragma once

#include <immintrin.h>

#include "kernel.hpp"
#include "shared_rows_x86.hpp"

namespace burrlab::kernel {
namespace {

struct Float {
  __m256 v;
};
struct Integer {
  __m256i v;
};
struct Mask {
  __m256 v;
};

inline Float set(float a) { return {_mm256_set1_ps(a)}; }
inline Integer set(int a) { return {_mm256_set1_epi32(a)}; }
inline Float load(const float* a) { return {_mm256_load_ps(a)}; }
inline void store(float* to, Float a) { _mm256_store_ps(to, a.v); }
inline void store(std::int32_t* to, Integer a) { _mm256_store_si256(reinterpret_cast<__m256i*>(to), a.v); }
inline Integer load(const std::int32_t* a) {
  return {_mm256_load_si256(reinterpret_cast<const __m256i*>(a))};
}
inline Integer index_in_row() { return {_mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7)}; }

inline Float operator+(Float a, Float b) { return {_mm256_add_ps(a.v, b.v)}; }
inline Float operator-(Float a, Float b) { return {_mm256_sub_ps(a.v, b.v)}; }
inline Float operator*(Float a, Float b) { return {_mm256_mul_ps(a.v, b.v)}; }
inline Float operator/(Float a, Float b) { return {_mm256_div_ps(a.v, b.v)}; }
inline Float square_root(Float a) { return {_mm256_sqrt_ps(a.v)}; }
inline Float smaller(Float a, Float b) { return {_mm256_min_ps(a.v, b.v)}; }
inline Float larger(Float a, Float b) { return {_mm256_max_ps(a.v, b.v)}; }
inline Mask operator<=(Float a, Float b) { return {_mm256_cmp_ps(a.v, b.v, _CMP_LE_OQ)}; }
inline Mask operator>(Float a, Float b) { return {_mm256_cmp_ps(a.v, b.v, _CMP_GT_OQ)}; }
inline Float select(Mask m, Float a, Float b) { return {_mm256_blendv_ps(b.v, a.v, m.v)}; }

inline Integer operator+(Integer a, Integer b) { return {_mm256_add_epi32(a.v, b.v)}; }
inline Integer operator-(Integer a, Integer b) { return {_mm256_sub_epi32(a.v, b.v)}; }
inline Mask operator>(Integer a, Integer b) { return {_mm256_castsi256_ps(_mm256_cmpgt_epi32(a.v, b.v))}; }
inline Mask operator==(Integer a, Integer b) { return {_mm256_castsi256_ps(_mm256_cmpeq_epi32(a.v, b.v))}; }
inline Integer times256(Integer a) { return {_mm256_slli_epi32(a.v, 8)}; }
inline Integer low16(Integer a) { return {_mm256_and_si256(a.v, _mm256_set1_epi32(0xFFFF))}; }
inline Integer high16(Integer a) { return {_mm256_srli_epi32(a.v, 16)}; }
inline Integer positive(Integer a) { return {_mm256_max_epi32(a.v, _mm256_setzero_si256())}; }
inline Integer only(Mask m, Integer a) { return {_mm256_and_si256(_mm256_castps_si256(m.v), a.v)}; }
inline Integer plus_one_where(Mask m, Integer a) { return {_mm256_sub_epi32(a.v, _mm256_castps_si256(m.v))}; }

inline Float to_float(Integer a) { return {_mm256_cvtepi32_ps(a.v)}; }
inline Integer truncate(Float a) { return {_mm256_cvttps_epi32(a.v)}; }
inline unsigned bits(Mask m) { return static_cast<unsigned>(_mm256_movemask_ps(m.v)); }

inline Integer times_index(Integer a) { return {_mm256_mullo_epi32(a.v, index_in_row().v)}; }
inline void horizontal_sums(Integer a, Integer b, Integer c, Integer d, std::int32_t* out) {
  const __m256i pairs = _mm256_hadd_epi32(_mm256_hadd_epi32(a.v, b.v), _mm256_hadd_epi32(c.v, d.v));
  _mm_storeu_si128(reinterpret_cast<__m128i*>(out),
                   _mm_add_epi32(_mm256_castsi256_si128(pairs), _mm256_extracti128_si256(pairs, 1)));
}

inline Integer load_row(const std::uint8_t* row) {
  return {_mm256_cvtepu8_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(row)))};
}
inline void take_from_row(std::uint8_t* row, Integer loss) {
#ifdef __AVX512VL__
  const __m128i bytes = _mm256_cvtepi32_epi8(loss.v);
#else
  const __m128i words = _mm_packs_epi32(_mm256_castsi256_si128(loss.v), _mm256_extracti128_si256(loss.v, 1));
  const __m128i bytes = _mm_packus_epi16(words, words);
#endif
  store_low_row(row, _mm_sub_epi8(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(row)), bytes));
}
inline unsigned rows_that_hold(const std::uint8_t* slab) {
#ifdef __AVX512VL__
  const __m512i rows = _mm512_load_si512(slab);
  return _mm512_test_epi64_mask(rows, rows);
#else
  const auto* half = reinterpret_cast<const __m256i*>(slab);
  const __m256i zero = _mm256_setzero_si256();
  const auto low = _mm256_movemask_pd(_mm256_castsi256_pd(_mm256_cmpeq_epi64(_mm256_load_si256(half), zero)));
  const auto high =
      _mm256_movemask_pd(_mm256_castsi256_pd(_mm256_cmpeq_epi64(_mm256_load_si256(half + 1), zero)));
  return static_cast<unsigned>((low | high << 4) ^ 0xFF);
#endif
}

inline Integer cell_offset(Integer row, Integer column) {
  const __m256i both = _mm256_or_si256(row.v, _mm256_slli_epi32(column.v, 16));
  return {_mm256_madd_epi16(both, _mm256_set1_epi32(depth_cell << 16 | depth_row))};
}
inline void look_up(const float* quads, const std::uint32_t* i, Float& a, Float& b, Float& c, Float& d) {
  const auto pair = [&](int low, int high) {
    return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_load_ps(quads + i[low])),
                                _mm_load_ps(quads + i[high]), 1);
  };
  const __m256 r0 = pair(0, 4), r1 = pair(1, 5), r2 = pair(2, 6), r3 = pair(3, 7);
  const __m256 t0 = _mm256_unpacklo_ps(r0, r1), t1 = _mm256_unpackhi_ps(r0, r1);
  const __m256 t2 = _mm256_unpacklo_ps(r2, r3), t3 = _mm256_unpackhi_ps(r2, r3);
  a.v = _mm256_shuffle_ps(t0, t2, 0x44);
  b.v = _mm256_shuffle_ps(t0, t2, 0xEE);
  c.v = _mm256_shuffle_ps(t1, t3, 0x44);
  d.v = _mm256_shuffle_ps(t1, t3, 0xEE);
}

/// 32-bit counter words of eight columns as two vectors of 64-bit lanes, even and odd columns. The lanes'
/// upper halves mean nothing, so a product needs no shuffle.
struct Words {
  __m256i even, odd;
};
inline Words first_words(std::uint32_t column) {
  const __m256i at = _mm256_set1_epi64x(column);
  return {_mm256_add_epi32(at, _mm256_setr_epi64x(0, 2, 4, 6)),
          _mm256_add_epi32(at, _mm256_setr_epi64x(1, 3, 5, 7))};
}
inline Words all_words(std::uint64_t a) {
  const __m256i v = _mm256_set1_epi64x(static_cast<long long>(a));
  return {v, v};
}
inline Words product(Words a, Words b) {
  return {_mm256_mul_epu32(a.even, b.even), _mm256_mul_epu32(a.odd, b.odd)};
}
inline Words high(Words a) { return {_mm256_srli_epi64(a.even, 32), _mm256_srli_epi64(a.odd, 32)}; }
inline Words operator^(Words a, Words b) {
  return {_mm256_xor_si256(a.even, b.even), _mm256_xor_si256(a.odd, b.odd)};
}
inline Words exclusive_or(Words a, Words b, Words c) {
#ifdef __AVX512VL__
  constexpr int odd = 0x96;  // truth table of a ^ b ^ c
  return {_mm256_ternarylogic_epi64(a.even, b.even, c.even, odd),
          _mm256_ternarylogic_epi64(a.odd, b.odd, c.odd, odd)};
#else
  return a ^ b ^ c;
#endif
}
inline Integer in_order(Words a) { return {_mm256_blend_epi32(a.even, _mm256_slli_epi64(a.odd, 32), 0xAA)}; }

struct Wide {
  __m256i v;
};
inline Wide wide_zero() { return {_mm256_setzero_si256()}; }
inline Wide add_product(Wide sum, Integer a, Integer b) {
  const __m256i odd = _mm256_mul_epu32(_mm256_srli_epi64(a.v, 32), _mm256_srli_epi64(b.v, 32));
  return {_mm256_add_epi64(sum.v, _mm256_add_epi64(_mm256_mul_epu32(a.v, b.v), odd))};
}
inline std::int64_t total(Wide a) {
  const __m128i pair = _mm_add_epi64(_mm256_castsi256_si128(a.v), _mm256_extracti128_si256(a.v, 1));
  return _mm_cvtsi128_si64(pair) + _mm_extract_epi64(pair, 1);
}

/// The table's entry for each lane's number. Without gathers, which are slow on some CPUs.
inline Float pick(const float* table, const std::uint8_t* numbers, bool few) {
  const __m256i n = load_row(numbers).v;
#ifdef __AVX512VL__
  const auto two = [&](int at) {
    return _mm256_permutex2var_ps(_mm256_loadu_ps(table + at), n, _mm256_loadu_ps(table + at + 8));
  };
#else
  const auto two = [&](int at) {
    const __m256 low = _mm256_permutevar8x32_ps(_mm256_loadu_ps(table + at), n);
    const __m256 high = _mm256_permutevar8x32_ps(_mm256_loadu_ps(table + at + 8), n);
    return _mm256_blendv_ps(low, high, _mm256_castsi256_ps(_mm256_slli_epi32(n, 28)));  // by bit 3
  };
#endif
  if (few) return {two(0)};
  const __m256 odd = _mm256_castsi256_ps(_mm256_slli_epi32(n, 27)),
               upper = _mm256_castsi256_ps(_mm256_slli_epi32(n, 26));  // bits 4 and 5
  return {_mm256_blendv_ps(_mm256_blendv_ps(two(0), two(16), odd), _mm256_blendv_ps(two(32), two(48), odd),
                           upper)};
}
inline Integer pick(const std::int32_t* table, const std::uint8_t* numbers, bool few) {
  return {_mm256_castps_si256(pick(reinterpret_cast<const float*>(table), numbers, few).v)};
}

inline std::uint32_t sum_where(const std::uint8_t* tile, const std::uint8_t* numbers, std::uint8_t number) {
  const __m256i which = _mm256_set1_epi8(static_cast<char>(number)), zero = _mm256_setzero_si256();
  __m256i sum = zero;
  for (unsigned at = 0; at < 512; at += 32) {
    const __m256i here =
        _mm256_cmpeq_epi8(_mm256_load_si256(reinterpret_cast<const __m256i*>(numbers + at)), which);
    const __m256i levels = _mm256_load_si256(reinterpret_cast<const __m256i*>(tile + at));
    sum = _mm256_add_epi64(sum, _mm256_sad_epu8(_mm256_and_si256(here, levels), zero));
  }
  return static_cast<std::uint32_t>(total({sum}));
}

inline void sum_levels(const std::uint8_t* tile, Sums& sums) {
  const __m256i zero = _mm256_setzero_si256(), weight = _mm256_set1_epi64x(0x0706050403020100);
  __m256i low = zero, high = zero, z = zero;  // by row, 64-bit lanes
  __m256i x_low = zero, x_high = zero;        // in 16-bit lanes, at most 8 * 13 * 255
  for (int slab = 7; slab >= 0; --slab) {
    const auto* half = reinterpret_cast<const __m256i*>(tile + 64 * slab);
    const __m256i a = _mm256_load_si256(half), b = _mm256_load_si256(half + 1);
    low = _mm256_add_epi64(low, _mm256_sad_epu8(a, zero));
    high = _mm256_add_epi64(high, _mm256_sad_epu8(b, zero));
    x_low = _mm256_add_epi16(x_low, _mm256_maddubs_epi16(a, weight));
    x_high = _mm256_add_epi16(x_high, _mm256_maddubs_epi16(b, weight));
    if (slab > 0)
      z = _mm256_add_epi64(z, _mm256_add_epi64(low, high));  // sum of z q as a sum of sums from above
  }
  // Each sum is below 2^32: two share a 64-bit lane.
  const __m256i one = _mm256_set1_epi16(1), lower = _mm256_set1_epi64x(0xFFFFFFFF);
  const __m256i x = _mm256_add_epi32(_mm256_madd_epi16(x_low, one), _mm256_madd_epi16(x_high, one));
  const __m256i y = _mm256_add_epi64(_mm256_mul_epu32(low, _mm256_setr_epi64x(0, 1, 2, 3)),
                                     _mm256_mul_epu32(high, _mm256_setr_epi64x(4, 5, 6, 7)));
  const __m256i mass_x = _mm256_add_epi64(
      _mm256_add_epi64(low, high),
      _mm256_slli_epi64(_mm256_add_epi32(_mm256_and_si256(x, lower), _mm256_srli_epi64(x, 32)), 32));
  const __m256i y_z = _mm256_add_epi64(y, _mm256_slli_epi64(z, 32));
  const __m256i pairs =
      _mm256_add_epi64(_mm256_unpacklo_epi64(mass_x, y_z), _mm256_unpackhi_epi64(mass_x, y_z));
  _mm_storeu_si128(reinterpret_cast<__m128i*>(&sums.after_mass),
                   _mm_add_epi64(_mm256_castsi256_si128(pairs), _mm256_extracti128_si256(pairs, 1)));
}

}  // namespace
}  // namespace burrlab::kernel
