// Stores of levels that others may load meanwhile (VoxelBone::copy_brick, BoneView). Rows of 8 are relaxed
// atomics: a copy during a tick is a mixture of old and new rows, but no data race; TickExecutor::version
// tells whether it is whole, BrickVersions whether a brick is. The tick's own loads need nothing, as no other
// thread stores. Local to each file: the kernels are compiled for different CPUs.
#pragma once

#include <cstdint>
#include <cstring>

namespace burrlab {
namespace {

#if defined(__GNUC__)
using SharedRow __attribute__((may_alias)) = std::uint64_t;

/// Stores 8 levels, aligned to 8 bytes.
inline void store_row(std::uint8_t* row, std::uint64_t levels) {
  __atomic_store_n(reinterpret_cast<SharedRow*>(row), levels, __ATOMIC_RELAXED);
}
inline std::uint64_t load_shared_row(const std::uint8_t* row) {
  return __atomic_load_n(reinterpret_cast<const SharedRow*>(row), __ATOMIC_RELAXED);
}
#else  // MSVC: volatile and aligned is one access
inline void store_row(std::uint8_t* row, std::uint64_t levels) {
  *reinterpret_cast<volatile std::uint64_t*>(row) = levels;
}
inline std::uint64_t load_shared_row(const std::uint8_t* row) {
  return *reinterpret_cast<const volatile std::uint64_t*>(row);
}
#endif

/// Loads the levels of a brick that another thread may be storing.
inline void load_shared_tile(std::uint8_t* to, const std::uint8_t* tile) {
  for (int row = 0; row < 512; row += 8) {
    const std::uint64_t levels = load_shared_row(tile + row);
    std::memcpy(to + row, &levels, sizeof levels);
  }
}

}  // namespace
}  // namespace burrlab
