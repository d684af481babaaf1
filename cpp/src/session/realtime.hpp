// Real-time scheduling of a thread, with a sentence for what the system grants or refuses.
#pragma once

#include <cstdint>
#include <string>
#include <thread>
#include <vector>

#include "burrlab/session/loop_settings.hpp"

namespace burrlab {

/// Steady clock [ns].
std::int64_t steady_now() noexcept;
/// Steady clock in `seconds` [ns]: now if negative or NaN, at most 100 years on.
std::int64_t steady_after(double seconds) noexcept;
/// Sleeps until the steady clock reads `time` [ns], as exactly as the system can.
void sleep_until(std::int64_t time) noexcept;
/// Looks every `pause` whether it has `ended`, until the steady clock reads `time` [ns]; returns the last
/// look.
template <class Ended, class Pause>
bool wait_until(std::int64_t time, Pause pause, const Ended& ended) {
  while (!ended() && steady_now() < time) std::this_thread::sleep_for(pause);
  return ended();
}
/// CPU time of this thread [ns].
std::int64_t thread_cpu_now() noexcept;

/// Asks for this thread; returns a sentence for each thing, granted or not.
std::vector<std::string> become_realtime(const RealtimeRequest& request);
/// Lets pages leave memory again.
void unlock_memory() noexcept;

}  // namespace burrlab
