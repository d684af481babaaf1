// Random numbers of a brick, Philox4x32-7 (docs/tick.md), eight columns of a slab side by side.
#pragma once

#include "philox.hpp"
#include "rows.hpp"

namespace burrlab::kernel {
namespace {

/// U of a slab: word i of a column holds the voxels y = 2i and 2i + 1.
struct Draw {
  Integer word[4];
};

inline Draw draw(const Draws& d, std::uint32_t column) {
  const Words m0 = all_words(philox_multiplier[0]), m1 = all_words(philox_multiplier[1]);
  const Words first = product(first_words(column), m0);
  const Words second = product(high(first) ^ all_words(d.after0_x2), m1);
  Words x0 = high(second) ^ all_words(d.after1_x0), x1 = second;
  Words x2 = first ^ all_words(d.after1_x2), x3 = all_words(d.after1_x3);
  for (int round = 2; round < philox_rounds; ++round) {
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
  for (int round = 0; round < philox_rounds; ++round) {
    const std::uint64_t a = std::uint64_t{philox_multiplier[0]} * x[0],
                        b = std::uint64_t{philox_multiplier[1]} * x[2];
    x[0] = static_cast<std::uint32_t>((b >> 32) ^ x[1] ^ at.draws.key[round][0]);
    x[1] = static_cast<std::uint32_t>(b);
    x[2] = static_cast<std::uint32_t>((a >> 32) ^ x[3] ^ at.draws.key[round][1]);
    x[3] = static_cast<std::uint32_t>(a);
  }
  return x[y >> 1] >> (16 * (y & 1)) & 0xFFFFu;
}

/// U of the slabs with rows to visit.
inline void draw_slabs(const Sphere& at, const Brick& brick, RowSet wanted, std::int32_t (*u)[lanes]) {
  RowSet by_slab = wanted | wanted >> 4;
  by_slab |= by_slab >> 2;
  by_slab = (by_slab | by_slab >> 1) & 0x0101010101010101u;
  for (; by_slab; by_slab &= by_slab - 1) {
    const unsigned z = lowest_bit(by_slab) / 8;
    const Draw drawn = draw(at.draws, brick.column + z * brick.columns_in_slab);
    for (int i = 0; i < 4; ++i) {
      store(u[8 * z + 2 * i], low16(drawn.word[i]));
      store(u[8 * z + 2 * i + 1], high16(drawn.word[i]));
    }
  }
}

void draw_field(const Draws& draws, std::uint32_t column, std::uint16_t* out) {
  const Draw u = draw(draws, column);
  for (int y = 0; y < 8; ++y) {
    alignas(64) std::int32_t row[lanes];
    store(row, y & 1 ? high16(u.word[y >> 1]) : low16(u.word[y >> 1]));
    for (int i = 0; i < lanes; ++i) out[8 * y + i] = static_cast<std::uint16_t>(row[i]);
  }
}

}  // namespace
}  // namespace burrlab::kernel
