// clang-format off: the lanes come first
#include "kernel/lanes_scalar.hpp"
#include "kernel/brick_visit.hpp"
// clang-format on

namespace burrlab::kernel {
#ifdef BURRLAB_X86_64
const Kernel scalar_kernel = BURRLAB_KERNEL("scalar");
#else
const Kernel scalar_kernel = BURRLAB_KERNEL("portable");
#endif
}  // namespace burrlab::kernel
