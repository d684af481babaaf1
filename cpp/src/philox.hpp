// Philox4x32: random bits as a pure function of (counter, key).
// Salmon, Moraes, Dror, Shaw, Parallel random numbers: as easy as 1, 2, 3, SC 2011.
#pragma once

#include <array>
#include <cstdint>

namespace burrlab {

using PhiloxBlock = std::array<std::uint32_t, 4>;

constexpr std::uint32_t philox_multiplier[2] = {0xD2511F53u, 0xCD9E8D57u};
constexpr std::uint32_t philox_weyl[2] = {0x9E3779B9u, 0xBB67AE85u};
/// Rounds of the tick's draws: the fewest that pass the authors' tests and ours.
constexpr int philox_rounds = 7;

template <int rounds>
PhiloxBlock philox4x32(PhiloxBlock counter, std::uint64_t key) {
  auto key0 = static_cast<std::uint32_t>(key), key1 = static_cast<std::uint32_t>(key >> 32);
  for (int round = 0; round < rounds; ++round) {
    const std::uint64_t a = std::uint64_t{philox_multiplier[0]} * counter[0];
    const std::uint64_t b = std::uint64_t{philox_multiplier[1]} * counter[2];
    counter = {static_cast<std::uint32_t>(b >> 32) ^ counter[1] ^ key0, static_cast<std::uint32_t>(b),
               static_cast<std::uint32_t>(a >> 32) ^ counter[3] ^ key1, static_cast<std::uint32_t>(a)};
    key0 += philox_weyl[0];
    key1 += philox_weyl[1];
  }
  return counter;
}

}  // namespace burrlab
