// clang-format off: the lanes come first
#include "kernel/lanes_avx2.hpp"
#include "kernel/brick_visit.hpp"
// clang-format on

namespace burrlab::kernel {
const Kernel avx512_kernel = BURRLAB_KERNEL("avx512");
}
