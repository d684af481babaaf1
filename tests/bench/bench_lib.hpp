// Shared by the benchmark's library: errors for ctypes, a stopwatch.
#pragma once

#ifdef __linux__
#include <sys/resource.h>
#endif

#include <chrono>
#include <cstdint>
#include <exception>
#include <string>
#include <type_traits>

#include "burrlab/types.hpp"

namespace burrlab::bench {

extern std::string last_error;

/// Returns the result of `work`; null or -1 if it throws, with the reason in `last_error`.
template <class Work>
auto guarded(Work work) -> decltype(work()) {
  try {
    return work();
  } catch (const std::exception& error) {
    last_error = error.what();
    if constexpr (std::is_pointer_v<decltype(work())>) {
      return nullptr;
    } else {
      return -1;
    }
  }
}

/// How often another process took this thread's core; 0 if the system does not tell.
inline std::int64_t interruptions() {
#ifdef __linux__
  rusage usage{};
  getrusage(RUSAGE_THREAD, &usage);
  return usage.ru_nivcsw;
#else
  return 0;
#endif
}

/// Wall-clock time, and whether it was interrupted.
class Stopwatch {
 public:
  /// Seconds since construction over `parts`.
  void stop(double parts, double* seconds, std::uint8_t* interrupted) const {
    *seconds = std::chrono::duration<double>(Clock::now() - start_).count() / parts;
    *interrupted = interruptions() != before_;
  }

 private:
  using Clock = std::chrono::steady_clock;
  std::int64_t before_ = interruptions();
  Clock::time_point start_ = Clock::now();  // last, so that nothing else is timed
};

inline Index3 index3(const std::int64_t* zyx) { return {zyx[0], zyx[1], zyx[2]}; }
inline Vec3 vec3(const double* xyz) { return {xyz[0], xyz[1], xyz[2]}; }

}  // namespace burrlab::bench
