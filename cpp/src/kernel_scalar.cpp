#include "kernel/brick_visit.hpp"
#include "kernel/lanes_scalar.hpp"

namespace burrlab::kernel {
#ifdef BURRLAB_X86_64
const Kernel scalar_kernel = BURRLAB_KERNEL("scalar");
#else
const Kernel scalar_kernel = BURRLAB_KERNEL("portable");
#endif
}  // namespace burrlab::kernel
