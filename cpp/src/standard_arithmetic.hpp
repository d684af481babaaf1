// The arithmetic of the core: round to nearest, subnormal numbers kept, no traps. A host may have set another
// one for its thread (-ffast-math does so for a whole program); it gets its own back.
#pragma once

#if !defined(__x86_64__) && !defined(_M_X64) && !defined(__aarch64__)
#include <cfenv>
#endif

namespace burrlab {

/// Sets the thread's arithmetic while it lives. Public functions whose numbers must not depend on the host's
/// have one; it takes some 3 ns where there is nothing to set. Its calls are never inlined: a compiler that
/// knows nothing of rounding modes would move an operation past the two instructions.
class StandardArithmetic {
 public:
  StandardArithmetic() noexcept;
  ~StandardArithmetic();
  StandardArithmetic(const StandardArithmetic&) = delete;

 private:
#if defined(__x86_64__) || defined(_M_X64)
  unsigned host_[2];
#elif defined(__aarch64__)
  unsigned long long host_;
#else
  std::fenv_t host_;
#endif
};

}  // namespace burrlab
