// How long a fuzz program runs: PROGRAM [INPUTS [SECONDS [SEED]]].
#pragma once

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>

struct FuzzRun {
  FuzzRun(int count, char** argument)
      : inputs(count > 1 ? std::strtoull(argument[1], nullptr, 10) : 100000),
        seed(count > 3 ? std::strtoull(argument[3], nullptr, 10) : 1),
        seconds(count > 2 ? std::strtod(argument[2], nullptr) : 600.0) {}

  double elapsed() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  }
  bool more() const { return done < inputs && (done % 1024 || elapsed() < seconds); }
  void say(std::uint64_t messages) const {
    std::printf("%llu inputs in %.1f s, seed %llu: %llu messages accepted\n", (unsigned long long)done,
                elapsed(), (unsigned long long)seed, (unsigned long long)messages);
  }

  std::uint64_t inputs, seed, done = 0;
  double seconds;
  std::chrono::steady_clock::time_point begin = std::chrono::steady_clock::now();
};
