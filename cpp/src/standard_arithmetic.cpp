#include "standard_arithmetic.hpp"

#include <cstdint>

#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#endif
#ifdef _MSC_VER
#define NOT_INLINED __declspec(noinline)
#else
#define NOT_INLINED __attribute__((noinline))
#endif

namespace burrlab {

#if defined(__x86_64__) || defined(_M_X64)
// Vectors have their own state; the C library asks the older unit's, as when it reads a number from a text.
static std::uint16_t older_state() {
  std::uint16_t state = 0x37F;
#ifdef __GNUC__
  asm volatile("fnstcw %0" : "=m"(state));
#endif
  return state;
}
static void set_older_state([[maybe_unused]] std::uint16_t state) {
#ifdef __GNUC__
  asm volatile("fldcw %0" ::"m"(state));
#endif
}
constexpr unsigned flags = 0x3F, nearest = 0x1F80;  // of exceptions that came; all masked
static std::uint16_t older_nearest(std::uint16_t state) { return std::uint16_t((state & ~0xC00) | 0x3F); }

NOT_INLINED StandardArithmetic::StandardArithmetic() noexcept : host_{_mm_getcsr(), older_state()} {
  if ((host_[0] & ~flags) != nearest) _mm_setcsr(nearest);
  const auto older = std::uint16_t(host_[1]);
  if (older_nearest(older) != older) set_older_state(older_nearest(older));
}
NOT_INLINED StandardArithmetic::~StandardArithmetic() {
  if ((host_[0] & ~flags) != nearest) _mm_setcsr(host_[0]);
  const auto older = std::uint16_t(host_[1]);
  if (older_nearest(older) != older) set_older_state(older);
}
#elif defined(__aarch64__)
NOT_INLINED StandardArithmetic::StandardArithmetic() noexcept {
  asm volatile("mrs %0, fpcr" : "=r"(host_)::"memory");
  if (host_) asm volatile("msr fpcr, %0" ::"r"(0ull) : "memory");
}
NOT_INLINED StandardArithmetic::~StandardArithmetic() {
  if (host_) asm volatile("msr fpcr, %0" ::"r"(host_) : "memory");
}
#else
NOT_INLINED StandardArithmetic::StandardArithmetic() noexcept {
  std::fegetenv(&host_);
  std::fesetenv(FE_DFL_ENV);
}
NOT_INLINED StandardArithmetic::~StandardArithmetic() { std::fesetenv(&host_); }
#endif

}  // namespace burrlab
