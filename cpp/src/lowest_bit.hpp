// The place of the lowest bit of a word. Local to each file: the kernels are compiled for different CPUs.
#pragma once

#include <cstdint>
#ifdef _MSC_VER
#include <intrin.h>
#endif

namespace burrlab {
namespace {

inline unsigned lowest_bit(std::uint64_t word) {
#ifdef _MSC_VER
  unsigned long place;
  _BitScanForward64(&place, word);
  return static_cast<unsigned>(place);
#else
  return static_cast<unsigned>(__builtin_ctzll(word));
#endif
}

}  // namespace
}  // namespace burrlab
