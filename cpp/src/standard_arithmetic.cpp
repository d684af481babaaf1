#include "standard_arithmetic.hpp"

#ifdef _MSC_VER
#define NOT_INLINED __declspec(noinline)
#else
#define NOT_INLINED __attribute__((noinline))
#endif

namespace burrlab {

NOT_INLINED StandardEnvironment::StandardEnvironment() noexcept {
  std::fegetenv(&host_);
  std::fesetenv(FE_DFL_ENV);
}
NOT_INLINED StandardEnvironment::~StandardEnvironment() { std::fesetenv(&host_); }

#ifdef BURRLAB_MXCSR
NOT_INLINED void StandardArithmetic::set(unsigned state) noexcept { _mm_setcsr(state); }
#endif

}  // namespace burrlab
