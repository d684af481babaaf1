#include "session/realtime.hpp"

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstring>

#ifdef __linux__
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>
#endif

namespace burrlab {

#ifdef __linux__

static std::int64_t read_clock(clockid_t clock) noexcept {
  timespec t;
  clock_gettime(clock, &t);
  return std::int64_t(t.tv_sec) * 1000000000 + t.tv_nsec;
}

std::int64_t steady_now() noexcept { return read_clock(CLOCK_MONOTONIC); }
std::int64_t thread_cpu_now() noexcept { return read_clock(CLOCK_THREAD_CPUTIME_ID); }

void sleep_until(std::int64_t time) noexcept {
  const timespec t{static_cast<time_t>(time / 1000000000), static_cast<long>(time % 1000000000)};
  while (steady_now() < time)  // a signal, or a layer above the system, may end a sleep early
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr);
}

static std::atomic<int> locking{0};  // loops of this process that hold its memory

std::vector<std::string> become_realtime(const RealtimeRequest& request) {
  std::vector<std::string> notes;
  const auto note = [&](const std::string& what, int error, const std::string& granted, const char* need) {
    notes.push_back(what + ": " +
                    (error ? std::string("not granted (") + std::strerror(error) + "); " + need : granted));
  };
  if (request.priority) {
    sched_param parameter{};
    parameter.sched_priority = request.level;
    note("real-time priority", pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameter),
         "first-in-first-out, level " + std::to_string(request.level),
         "it needs CAP_SYS_NICE or an rtprio limit, and ticks will be late beside other work");
  } else {
    notes.push_back("real-time priority: not asked for");
  }
  if (request.lock_memory) {
    ++locking;
    note("memory", mlockall(MCL_CURRENT) == 0 ? 0 : errno, "locked",
         "it needs CAP_IPC_LOCK or a larger memlock limit, and a page fault can delay a tick");
  }
  if (request.cpu >= 0) {
    cpu_set_t set;
    CPU_ZERO(&set);
    if (request.cpu < CPU_SETSIZE) CPU_SET(static_cast<unsigned>(request.cpu), &set);
    note("CPU " + std::to_string(request.cpu), pthread_setaffinity_np(pthread_self(), sizeof set, &set),
         "the loop stays on it", "the loop may move between CPUs");
  }
  note("timer slack", prctl(PR_SET_TIMERSLACK, 1UL) == 0 ? 0 : errno, "1 ns", "wake-ups may be 50 us late");
  return notes;
}

void unlock_memory() noexcept {
  if (--locking == 0) munlockall();
}

#else

std::int64_t steady_now() noexcept {
  using namespace std::chrono;
  return duration_cast<nanoseconds>(steady_clock::now().time_since_epoch()).count();
}
std::int64_t thread_cpu_now() noexcept { return steady_now(); }

void sleep_until(std::int64_t time) noexcept {
  for (std::int64_t now; (now = steady_now()) < time;)  // Windows may round a sleep down
    std::this_thread::sleep_for(std::chrono::nanoseconds(time - now));
}

std::vector<std::string> become_realtime(const RealtimeRequest&) {
  return {"real-time priority, locked memory, CPU pinning and timer slack: not available on this system"};
}

void unlock_memory() noexcept {}

#endif

std::int64_t steady_after(double seconds) noexcept {
  constexpr double longest = 3.2e9;  // [s]
  return steady_now() + (seconds > 0.0 ? std::int64_t(1e9 * (seconds < longest ? seconds : longest)) : 0);
}

}  // namespace burrlab
