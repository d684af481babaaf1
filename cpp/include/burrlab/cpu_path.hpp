// Which code the tick runs: one for each instruction set, equal to the bit.
#pragma once

#include <string>
#include <vector>

namespace burrlab {

/// Those that this CPU runs, from the plainest to the fastest: on x86-64 "scalar", "portable" (SSE2), "avx2",
/// "avx512"; elsewhere "portable".
std::vector<std::string> cpu_paths();
/// The one that contacts made from now on use: the fastest, or what the environment variable
/// BURRLAB_CPU_PATH names. Throws std::invalid_argument if that is none of `cpu_paths()`.
std::string cpu_path();
void use_cpu_path(const std::string& name);  ///< throws std::invalid_argument

}  // namespace burrlab
