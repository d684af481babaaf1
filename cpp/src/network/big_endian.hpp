// Numbers in network byte order, whatever the machine's.
#pragma once

#include <cstdint>
#include <cstring>

namespace burrlab::openigtlink {

template <class Unsigned>
Unsigned get(const std::uint8_t* at) {
  Unsigned value = 0;
  for (std::size_t i = 0; i < sizeof(Unsigned); ++i) value = Unsigned((std::uint64_t(value) << 8) | at[i]);
  return value;
}

template <class Unsigned>
void put(std::uint8_t* at, Unsigned value) {
  for (std::size_t i = 0; i < sizeof(Unsigned); ++i)
    at[i] = std::uint8_t(std::uint64_t(value) >> (8 * (sizeof(Unsigned) - 1 - i)));
}

inline float get_float32(const std::uint8_t* at) {
  const std::uint32_t word = get<std::uint32_t>(at);
  float value;
  std::memcpy(&value, &word, sizeof value);
  return value;
}

inline double get_float64(const std::uint8_t* at) {
  const std::uint64_t word = get<std::uint64_t>(at);
  double value;
  std::memcpy(&value, &word, sizeof value);
  return value;
}

inline void put_float32(std::uint8_t* at, float value) {
  std::uint32_t word;
  std::memcpy(&word, &value, sizeof word);
  put(at, word);
}

inline void put_float64(std::uint8_t* at, double value) {
  std::uint64_t word;
  std::memcpy(&word, &value, sizeof word);
  put(at, word);
}

}  // namespace burrlab::openigtlink
