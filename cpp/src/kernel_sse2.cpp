// clang-format off: the lanes come first
#include "kernel/lanes_sse2.hpp"
#include "kernel/brick_visit.hpp"
// clang-format on

namespace burrlab::kernel {
const Kernel sse2_kernel = BURRLAB_KERNEL("portable");
}
