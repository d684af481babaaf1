// The arithmetic of the core: round to nearest, subnormal numbers kept, no traps. A host may have set another
// one for its thread (-ffast-math does so for a whole program); it gets its own back.
#pragma once

#include <cfenv>
#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#define BURRLAB_MXCSR
#endif

namespace burrlab {

/// The part that vector and scalar instructions use. Public functions whose numbers must not depend on the
/// host's have one. The calls that change it are never inlined: a compiler that knows nothing of rounding
/// modes would move an operation past the instruction.
#ifdef BURRLAB_MXCSR
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
class StandardEnvironment;
using StandardArithmetic = StandardEnvironment;
#endif

/// All of the thread's floating-point state while it lives. Reading a number from a text asks for all of it,
/// and so do the exponentials of some mathematical libraries.
class StandardEnvironment {
 public:
  StandardEnvironment() noexcept;
  ~StandardEnvironment();
  StandardEnvironment(const StandardEnvironment&) = delete;

 private:
#ifdef BURRLAB_MXCSR
  StandardArithmetic arithmetic_;  // the default environment of some libraries is that of the x87 unit alone
#endif
  std::fenv_t host_;
};

}  // namespace burrlab
