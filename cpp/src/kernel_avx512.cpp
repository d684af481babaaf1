#include "kernel/brick_visit.hpp"
#include "kernel/lanes_avx512.hpp"

namespace burrlab::kernel {
const Kernel avx512_kernel = BURRLAB_KERNEL("avx512");
}
