// The arithmetic of the core: round to nearest, subnormal numbers kept, no traps. A host may have set another
// one for its thread (-ffast-math does so for a whole program); it gets its own back.
#pragma once

#include <cfenv>
#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#endif

namespace burrlab {

/// All of the thread's floating-point state while it lives. Reading a number from a text asks for all of it.
class StandardEnvironment {
 public:
  StandardEnvironment() noexcept;
  ~StandardEnvironment();
  StandardEnvironment(const StandardEnvironment&) = delete;

 private:
  std::fenv_t host_;
};

/// The part that vector and scalar instructions use. Public functions whose numbers must not depend on the
/// host's have one. The calls that change it are never inlined: a compiler that knows nothing of rounding
/// modes would move an operation past the instruction.
#if defined(__x86_64__) || defined(_M_X64)
class StandardArithmetic {
 public:
  StandardArithmetic() noexcept : host_(_mm_getcsr()) {
    if (differs()) set(nearest);
  }
  ~StandardArithmetic() {
    if (differs()) set(host_);
  }
  StandardArithmetic(const StandardArithmetic&) = delete;

 private:
  static constexpr unsigned flags = 0x3F, nearest = 0x1F80;  // of exceptions that came; all masked
  bool differs() const { return (host_ & ~flags) != nearest; }
  static void set(unsigned state) noexcept;

  unsigned host_;
};
#else
using StandardArithmetic = StandardEnvironment;
#endif

}  // namespace burrlab
