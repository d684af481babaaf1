// What an operating system grants a thread that must wake in time, and a sentence for what it does not.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace burrlab {

/// Steady clock [ns].
std::int64_t steady_now() noexcept;
/// What the steady clock will read in `seconds` [ns]: now for what is negative or NaN, at most 100 years on.
std::int64_t steady_after(double seconds) noexcept;
/// Sleeps until the steady clock reads `time` [ns]; as exactly as the system can.
void sleep_until(std::int64_t time) noexcept;
/// CPU time of this thread [ns].
std::int64_t thread_cpu_now() noexcept;

/// What a thread asks for.
struct RealtimeRequest {
  bool priority = true;     ///< first-in-first-out scheduling before all ordinary threads
  int level = 80;           ///< of that priority
  bool lock_memory = true;  ///< no page of the process is taken out of memory
  int cpu = -1;             ///< to stay on; -1: any
};

/// Asks for this thread; one sentence for each thing, granted or not.
std::vector<std::string> become_realtime(const RealtimeRequest& request);
/// Pages may go again.
void unlock_memory() noexcept;

}  // namespace burrlab
