#include "kernel/brick_visit.hpp"
#include "kernel/lanes_sse2.hpp"

namespace burrlab::kernel {
const Kernel sse2_kernel = BURRLAB_KERNEL("portable");
}
