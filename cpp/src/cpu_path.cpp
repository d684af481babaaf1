#include "cpu_path.hpp"

#include <atomic>
#include <cstdlib>

#include "burrlab/error.hpp"
#include "kernel/kernel.hpp"
#if defined(BURRLAB_X86_64) && defined(_MSC_VER)
#include <intrin.h>
#endif

namespace burrlab {
namespace {

#ifdef BURRLAB_X86_64
#ifdef _MSC_VER
bool bit(int leaf, int word, int index) {
  int registers[4];
  __cpuidex(registers, leaf, 0);
  return registers[word] >> index & 1;
}
bool saved_by_system(unsigned long long state) { return bit(1, 2, 27) && (_xgetbv(0) & state) == state; }
bool has_avx2() { return saved_by_system(0x06) && bit(7, 1, 5) && bit(7, 1, 3) && bit(7, 1, 8); }
bool has_avx512() {
  return has_avx2() && saved_by_system(0xE6) && bit(7, 1, 16) && bit(7, 1, 17) && bit(7, 1, 30) &&
         bit(7, 1, 31);
}
#else
bool has_avx2() {
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
}
bool has_avx512() {
  return has_avx2() && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
         __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
}
#endif
#endif

std::vector<const kernel::Kernel*> kernels() {
  std::vector<const kernel::Kernel*> found{&kernel::scalar_kernel};
#ifdef BURRLAB_X86_64
  found.push_back(&kernel::sse2_kernel);
  if (has_avx2()) found.push_back(&kernel::avx2_kernel);
  if (has_avx512()) found.push_back(&kernel::avx512_kernel);
#elif defined(BURRLAB_AARCH64)
  found.push_back(&kernel::neon_kernel);
#endif
  return found;
}

const kernel::Kernel* kernel_named(const std::string& name, const char* who) {
  std::string known;
  for (const kernel::Kernel* k : kernels()) {
    if (name == k->name) return k;
    known += (known.empty() ? "" : ", ") + std::string(k->name);
  }
  throw InvalidArgument(std::string(who) + " must be one that this CPU runs, " + known + "; got '" + name +
                        "'");
}

std::atomic<const kernel::Kernel*>& chosen() {
  static std::atomic<const kernel::Kernel*> one = [] {
    const char* name = std::getenv("BURRLAB_CPU_PATH");
    return name && *name ? kernel_named(name, "BURRLAB_CPU_PATH") : kernels().back();
  }();
  return one;
}

}  // namespace

namespace kernel {
const Kernel& current_kernel() { return *chosen().load(); }
}  // namespace kernel

std::vector<std::string> cpu_paths() {
  std::vector<std::string> names;
  for (const kernel::Kernel* k : kernels()) names.emplace_back(k->name);
  return names;
}

std::string cpu_path() { return kernel::current_kernel().name; }
void use_cpu_path(const std::string& name) { chosen().store(kernel_named(name, "cpu_path")); }

}  // namespace burrlab
