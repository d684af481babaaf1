// clang-format off: the lanes come first
#include "kernel/lanes_neon.hpp"
#include "kernel/brick_visit.hpp"
// clang-format on

namespace burrlab::kernel {
const Kernel neon_kernel = BURRLAB_KERNEL("neon");
}
