#include "kernel/brick_visit.hpp"
#include "kernel/lanes_avx2.hpp"

namespace burrlab::kernel {
const Kernel avx2_kernel = BURRLAB_KERNEL("avx2");
}
