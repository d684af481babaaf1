// Stores of rows from vector registers, which another thread may load meanwhile (shared_rows.hpp). An aligned
// store of 8 bytes is whole on x86-64, also from a vector register (Intel SDM vol. 3, "Guaranteed atomic
// operations"), but compilers move relaxed atomics through a general register, which costs the tick 2 to 4 %.
// So the instruction is named: not an access of the language, hence no data race, and nothing a compiler
// could split. A thread sanitizer sees only the compiler's own atomics.
#pragma once

#include <emmintrin.h>

#include "shared_rows.hpp"

#if defined(__SANITIZE_THREAD__)
#define BURRLAB_WATCHED_BY_SANITIZER 1
#elif defined(__has_feature)
#if __has_feature(thread_sanitizer)
#define BURRLAB_WATCHED_BY_SANITIZER 1
#endif
#endif

#ifdef __AVX__
#define BURRLAB_VECTOR_STORE "v"
#else
#define BURRLAB_VECTOR_STORE ""
#endif

namespace burrlab {
namespace {

/// The lower 8 levels of a register.
inline void store_low_row(std::uint8_t* row, __m128i levels) {
#if defined(__GNUC__) && !defined(BURRLAB_WATCHED_BY_SANITIZER)
  asm(BURRLAB_VECTOR_STORE "movq %1, %0" : "=m"(*reinterpret_cast<SharedRow*>(row)) : "v"(levels));
#else
  store_row(row, static_cast<std::uint64_t>(_mm_cvtsi128_si64(levels)));
#endif
}

}  // namespace
}  // namespace burrlab
