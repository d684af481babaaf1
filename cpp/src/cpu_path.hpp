// The tick's code for each instruction set. All give the same bits.
#pragma once

#include <string>
#include <vector>

namespace burrlab {

/// The paths that this CPU runs, from the plainest to the fastest: on x86-64 "scalar", "portable" (SSE2),
/// "avx2", "avx512"; on AArch64 "portable", "neon"; elsewhere "portable".
std::vector<std::string> cpu_paths();
/// The path that new contacts use: the fastest, or the one that the environment variable BURRLAB_CPU_PATH
/// names. Throws InvalidArgument if the variable names none of `cpu_paths()`.
std::string cpu_path();
void use_cpu_path(const std::string& name);  ///< throws InvalidArgument

}  // namespace burrlab
