// A tick's random numbers before they meet a voxel, and as a field over a volume.
#include <algorithm>

#include "kernel/kernel.hpp"
#include "philox.hpp"
#include "tick.hpp"

namespace burrlab {

namespace kernel {

Draws draws(std::uint64_t seed, std::uint64_t tick, std::uint32_t who) {
  Draws d{};
  d.tick_low = static_cast<std::uint32_t>(tick);
  d.tick_high = static_cast<std::uint32_t>(tick >> 32);
  d.who = who;
  for (std::uint32_t round = 0; round < philox_rounds; ++round) {
    d.key[round][0] = static_cast<std::uint32_t>(static_cast<std::uint32_t>(seed) + round * philox_weyl[0]);
    d.key[round][1] =
        static_cast<std::uint32_t>(static_cast<std::uint32_t>(seed >> 32) + round * philox_weyl[1]);
  }
  const std::uint64_t b =
      std::uint64_t{philox_multiplier[1]} * d.tick_high;  // round 0, the same for all columns
  const std::uint64_t x0 = static_cast<std::uint32_t>(b >> 32) ^ d.tick_low ^ d.key[0][0];
  const std::uint64_t a = philox_multiplier[0] * x0;  // round 1
  d.after0_x2 = d.who ^ d.key[0][1];
  d.after1_x0 = static_cast<std::uint32_t>(b) ^ d.key[1][0];
  d.after1_x2 = static_cast<std::uint32_t>(a >> 32) ^ d.key[1][1];
  d.after1_x3 = static_cast<std::uint32_t>(a);
  return d;
}

}  // namespace kernel

std::vector<std::uint16_t> random_field(const Index3& shape, std::uint64_t seed, std::uint64_t tick,
                                        std::uint32_t index, std::uint32_t draw) {
  const kernel::Kernel& code = kernel::current_kernel();
  const kernel::Draws d = kernel::draws(seed, tick, index + (draw << 31));
  const auto columns_in_row = static_cast<std::uint32_t>(shape[2]);
  const auto columns_in_slab = columns_in_row * static_cast<std::uint32_t>((shape[1] + 7) / 8);
  std::vector<std::uint16_t> out(static_cast<std::size_t>(product(shape)));
  for (std::int64_t z = 0; z < shape[0]; ++z) {
    for (std::int64_t y = 0; y < shape[1]; y += 8) {
      for (std::int64_t x = 0; x < shape[2]; x += 8) {
        std::uint16_t slab[64];
        code.draw(d,
                  static_cast<std::uint32_t>(z) * columns_in_slab +
                      static_cast<std::uint32_t>(y / 8) * columns_in_row + static_cast<std::uint32_t>(x),
                  slab);
        for (std::int64_t j = y; j < std::min(y + 8, shape[1]); ++j)
          for (std::int64_t i = x; i < std::min(x + 8, shape[2]); ++i)
            out[static_cast<std::size_t>((z * shape[1] + j) * shape[2] + i)] = slab[8 * (j - y) + i - x];
      }
    }
  }
  return out;
}

}  // namespace burrlab
