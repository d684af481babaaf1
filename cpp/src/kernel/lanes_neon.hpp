// Eight lanes in pairs of NEON registers, which every aarch64 has: a row of a brick; see lanes_scalar.hpp.
#pragma once

#include <arm_neon.h>

#include "kernel.hpp"
#include "shared_rows.hpp"

namespace burrlab::kernel {
namespace {

struct Float {
  float32x4_t a, b;
};
struct Integer {
  int32x4_t a, b;
};
struct Mask {
  uint32x4_t a, b;
};

inline Float set(float a) { return {vdupq_n_f32(a), vdupq_n_f32(a)}; }
inline Integer set(int a) { return {vdupq_n_s32(a), vdupq_n_s32(a)}; }
inline Float load(const float* p) { return {vld1q_f32(p), vld1q_f32(p + 4)}; }
inline Integer load(const std::int32_t* p) { return {vld1q_s32(p), vld1q_s32(p + 4)}; }
inline void store(float* to, Float x) { vst1q_f32(to, x.a), vst1q_f32(to + 4, x.b); }
inline void store(std::int32_t* to, Integer x) { vst1q_s32(to, x.a), vst1q_s32(to + 4, x.b); }
inline Integer index_in_row() {
  static constexpr std::int32_t index[8] = {0, 1, 2, 3, 4, 5, 6, 7};
  return load(index);
}

inline Float operator+(Float x, Float y) { return {vaddq_f32(x.a, y.a), vaddq_f32(x.b, y.b)}; }
inline Float operator-(Float x, Float y) { return {vsubq_f32(x.a, y.a), vsubq_f32(x.b, y.b)}; }
inline Float operator*(Float x, Float y) { return {vmulq_f32(x.a, y.a), vmulq_f32(x.b, y.b)}; }
inline Float operator/(Float x, Float y) { return {vdivq_f32(x.a, y.a), vdivq_f32(x.b, y.b)}; }
inline Float square_root(Float x) { return {vsqrtq_f32(x.a), vsqrtq_f32(x.b)}; }
inline Float smaller(Float x, Float y) { return {vminq_f32(x.a, y.a), vminq_f32(x.b, y.b)}; }
inline Float larger(Float x, Float y) { return {vmaxq_f32(x.a, y.a), vmaxq_f32(x.b, y.b)}; }
inline Mask operator<=(Float x, Float y) { return {vcleq_f32(x.a, y.a), vcleq_f32(x.b, y.b)}; }
inline Mask operator>(Float x, Float y) { return {vcgtq_f32(x.a, y.a), vcgtq_f32(x.b, y.b)}; }
inline Float select(Mask m, Float x, Float y) { return {vbslq_f32(m.a, x.a, y.a), vbslq_f32(m.b, x.b, y.b)}; }

inline Integer operator+(Integer x, Integer y) { return {vaddq_s32(x.a, y.a), vaddq_s32(x.b, y.b)}; }
inline Integer operator-(Integer x, Integer y) { return {vsubq_s32(x.a, y.a), vsubq_s32(x.b, y.b)}; }
inline Mask operator>(Integer x, Integer y) { return {vcgtq_s32(x.a, y.a), vcgtq_s32(x.b, y.b)}; }
inline Mask operator==(Integer x, Integer y) { return {vceqq_s32(x.a, y.a), vceqq_s32(x.b, y.b)}; }
inline Integer times256(Integer x) { return {vshlq_n_s32(x.a, 8), vshlq_n_s32(x.b, 8)}; }
inline Integer only(Mask m, Integer x) {
  return {vandq_s32(vreinterpretq_s32_u32(m.a), x.a), vandq_s32(vreinterpretq_s32_u32(m.b), x.b)};
}
inline Integer low16(Integer x) { return only({vdupq_n_u32(0xFFFF), vdupq_n_u32(0xFFFF)}, x); }
inline Integer high16(Integer x) {
  const auto shifted = [](int32x4_t v) {
    return vreinterpretq_s32_u32(vshrq_n_u32(vreinterpretq_u32_s32(v), 16));
  };
  return {shifted(x.a), shifted(x.b)};
}
inline Integer positive(Integer x) { return {vmaxq_s32(x.a, set(0).a), vmaxq_s32(x.b, set(0).b)}; }
inline Integer plus_one_where(Mask m, Integer x) { return x - only(m, set(-1)); }

inline Float to_float(Integer x) { return {vcvtq_f32_s32(x.a), vcvtq_f32_s32(x.b)}; }
inline Integer truncate(Float x) { return {vcvtq_s32_f32(x.a), vcvtq_s32_f32(x.b)}; }
inline unsigned bits(Mask m) {
  static constexpr std::uint32_t bit[8] = {1, 2, 4, 8, 16, 32, 64, 128};
  return vaddvq_u32(vorrq_u32(vandq_u32(m.a, vld1q_u32(bit)), vandq_u32(m.b, vld1q_u32(bit + 4))));
}

inline Integer times_index(Integer x) {
  const Integer index = index_in_row();
  return {vmulq_s32(x.a, index.a), vmulq_s32(x.b, index.b)};
}
inline void horizontal_sums(Integer a, Integer b, Integer c, Integer d, std::int32_t* out) {
  const auto pairs = [](Integer x, Integer y) {
    return vpaddq_s32(vaddq_s32(x.a, x.b), vaddq_s32(y.a, y.b));
  };
  vst1q_s32(out, vpaddq_s32(pairs(a, b), pairs(c, d)));
}

inline Integer load_row(const std::uint8_t* row) {
  const uint16x8_t words = vmovl_u8(vld1_u8(row));
  return {vreinterpretq_s32_u32(vmovl_u16(vget_low_u16(words))),
          vreinterpretq_s32_u32(vmovl_high_u16(words))};
}
inline void take_from_row(std::uint8_t* row, Integer loss) {
  const int16x8_t words = vcombine_s16(vmovn_s32(loss.a), vmovn_s32(loss.b));
  const uint8x8_t left = vsub_u8(vld1_u8(row), vmovn_u16(vreinterpretq_u16_s16(words)));
  store_row(row, vget_lane_u64(vreinterpret_u64_u8(left), 0));
}
inline unsigned rows_that_hold(const std::uint8_t* slab) {
  const auto held = [&](int pair) {
    const uint64x2_t rows = vreinterpretq_u64_u8(vld1q_u8(slab + 16 * pair));
    return vreinterpretq_u32_u64(vtstq_u64(rows, rows));
  };
  return bits({vuzp1q_u32(held(0), held(1)), vuzp1q_u32(held(2), held(3))});
}

inline Integer cell_offset(Integer row, Integer column) {
  const auto offset = [](int32x4_t r, int32x4_t c) {
    return vmlaq_n_s32(vmulq_n_s32(r, depth_row), c, depth_cell);
  };
  return {offset(row.a, column.a), offset(row.b, column.b)};
}
inline void look_up(const float* quads, const std::uint32_t* i, Float& a, Float& b, Float& c, Float& d) {
  const auto four = [&](const std::uint32_t* at, float32x4_t& w, float32x4_t& x, float32x4_t& y,
                        float32x4_t& z) {
    const float32x4_t r0 = vld1q_f32(quads + at[0]), r1 = vld1q_f32(quads + at[1]);
    const float32x4_t r2 = vld1q_f32(quads + at[2]), r3 = vld1q_f32(quads + at[3]);
    const auto wide = [](float32x4_t v) { return vreinterpretq_f64_f32(v); };
    const float64x2_t wy01 = wide(vtrn1q_f32(r0, r1)), xz01 = wide(vtrn2q_f32(r0, r1));
    const float64x2_t wy23 = wide(vtrn1q_f32(r2, r3)), xz23 = wide(vtrn2q_f32(r2, r3));
    w = vreinterpretq_f32_f64(vtrn1q_f64(wy01, wy23)), x = vreinterpretq_f32_f64(vtrn1q_f64(xz01, xz23));
    y = vreinterpretq_f32_f64(vtrn2q_f64(wy01, wy23)), z = vreinterpretq_f32_f64(vtrn2q_f64(xz01, xz23));
  };
  four(i, a.a, b.a, c.a, d.a);
  four(i + 4, a.b, b.b, c.b, d.b);
}

/// 32-bit counter words of eight columns in 64-bit lanes, in order; the upper halves mean nothing.
struct Words {
  uint64x2_t v[4];
};
inline Words first_words(std::uint32_t column) {
  static constexpr std::uint64_t two[2] = {0, 1};
  Words words;
  for (unsigned i = 0; i < 4; ++i) words.v[i] = vaddq_u64(vdupq_n_u64(column + 2 * i), vld1q_u64(two));
  return words;
}
inline Words all_words(std::uint64_t a) {
  const uint64x2_t v = vdupq_n_u64(a);
  return {{v, v, v, v}};
}
inline Words product(Words a, Words b) {
  for (int i = 0; i < 4; ++i) a.v[i] = vmull_u32(vmovn_u64(a.v[i]), vmovn_u64(b.v[i]));
  return a;
}
inline Words high(Words a) {
  for (uint64x2_t& v : a.v) v = vshrq_n_u64(v, 32);
  return a;
}
inline Words operator^(Words a, Words b) {
  for (int i = 0; i < 4; ++i) a.v[i] = veorq_u64(a.v[i], b.v[i]);
  return a;
}
inline Words exclusive_or(Words a, Words b, Words c) { return a ^ b ^ c; }
inline Integer in_order(Words a) {
  const auto low = [&](int i) { return vreinterpret_s32_u32(vmovn_u64(a.v[i])); };
  return {vcombine_s32(low(0), low(1)), vcombine_s32(low(2), low(3))};
}

struct Wide {
  int64x2_t v;
};
inline Wide wide_zero() { return {vdupq_n_s64(0)}; }
inline Wide add_product(Wide sum, Integer a, Integer b) {
  const auto add = [](int64x2_t to, int32x4_t x, int32x4_t y) {
    return vmlal_high_s32(vmlal_s32(to, vget_low_s32(x), vget_low_s32(y)), x, y);
  };
  return {add(add(sum.v, a.a, b.a), a.b, b.b)};
}
inline std::int64_t total(Wide a) { return vaddvq_s64(a.v); }

template <class Value>
inline auto pick(const Value* table, const std::uint8_t* numbers, bool) {
  Value each[8];
  for (int i = 0; i < 8; ++i) each[i] = table[numbers[i]];
  return load(each);
}

inline std::uint32_t sum_where(const std::uint8_t* tile, const std::uint8_t* numbers, std::uint8_t number) {
  uint16x8_t sum = vdupq_n_u16(0);  // a lane at most 32 * 510
  for (unsigned at = 0; at < 512; at += 16) {
    const uint8x16_t here = vceqq_u8(vld1q_u8(numbers + at), vdupq_n_u8(number));
    sum = vpadalq_u8(sum, vandq_u8(here, vld1q_u8(tile + at)));
  }
  return vaddlvq_u16(sum);
}

inline void sum_levels(const std::uint8_t* tile, Sums& sums) {
  const uint16x8_t zero = vdupq_n_u16(0);
  uint16x8_t mass = zero, y_sum = zero, z_sum = zero;  // by x; a lane at most 28 * 8 * 255
  for (std::uint16_t z = 0; z < 8; ++z) {
    uint16x8_t slab = zero;
    for (std::uint16_t y = 0; y < 8; ++y) {
      const uint16x8_t row = vmovl_u8(vld1_u8(tile + 64 * z + 8 * y));
      slab = vaddq_u16(slab, row);
      y_sum = vmlaq_n_u16(y_sum, row, y);
    }
    mass = vaddq_u16(mass, slab);
    z_sum = vmlaq_n_u16(z_sum, slab, z);
  }
  static constexpr std::uint16_t index[8] = {0, 1, 2, 3, 4, 5, 6, 7};
  const uint16x8_t x = vld1q_u16(index);
  sums.after_mass = vaddlvq_u16(mass);
  sums.after_x = vaddvq_u32(vmlal_high_u16(vmull_u16(vget_low_u16(mass), vget_low_u16(x)), mass, x));
  sums.after_y = vaddlvq_u16(y_sum);
  sums.after_z = vaddlvq_u16(z_sum);
}

}  // namespace
}  // namespace burrlab::kernel
