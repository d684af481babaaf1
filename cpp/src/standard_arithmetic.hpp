// The arithmetic of the core: round to nearest, subnormal numbers kept, no traps. A host may have set another
// one for its thread (-ffast-math does so for a whole program); it gets its own back.
#pragma once

#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#elif !defined(__aarch64__)
#include <cfenv>
#endif

namespace burrlab {

/// Sets the thread's arithmetic while it lives. Public functions whose numbers must not depend on the host's
/// have one; it takes some 2 ns where there is nothing to set.
class StandardArithmetic {
 public:
  StandardArithmetic(const StandardArithmetic&) = delete;
#if defined(__x86_64__) || defined(_M_X64)
  StandardArithmetic() noexcept : host_(_mm_getcsr()) {
    if ((host_ & ~flags) != nearest) _mm_setcsr(nearest);
  }
  ~StandardArithmetic() {
    if ((host_ & ~flags) != nearest) _mm_setcsr(host_);
  }

 private:
  static constexpr unsigned flags = 0x3F, nearest = 0x1F80;  // of exceptions that came; all masked
  unsigned host_;
#elif defined(__aarch64__)
  StandardArithmetic() noexcept {
    asm volatile("mrs %0, fpcr" : "=r"(host_)::"memory");
    if (host_) asm volatile("msr fpcr, %0" ::"r"(0ull) : "memory");
  }
  ~StandardArithmetic() {
    if (host_) asm volatile("msr fpcr, %0" ::"r"(host_) : "memory");
  }

 private:
  unsigned long long host_;
#else
  StandardArithmetic() noexcept {
    std::fegetenv(&host_);
    std::fesetenv(FE_DFL_ENV);
  }
  ~StandardArithmetic() { std::fesetenv(&host_); }

 private:
  std::fenv_t host_;
#endif
};

}  // namespace burrlab
