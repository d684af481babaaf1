// 10^5 ticks through the installed library: prints digest, sum of forces in hexadecimal and seconds. Fails if
// one of them allocates, locks or begins a thread, or if an error of the library is not caught here.
#include <dlfcn.h>
#include <pthread.h>

#include <burrlab/burrlab.hpp>
#include <cstdio>
#include <ctime>
#include <mutex>

#include "count_allocations.hpp"

static std::atomic<long> locks{0}, threads{0};
extern "C" int pthread_mutex_lock(pthread_mutex_t* mutex) {
  static const auto next =
      reinterpret_cast<int (*)(pthread_mutex_t*)>(dlsym(RTLD_NEXT, "pthread_mutex_lock"));
  ++locks;
  return next(mutex);
}
extern "C" int pthread_create(pthread_t* thread, const pthread_attr_t* attributes, void* (*run)(void*),
                              void* of) {
  static const auto next =
      reinterpret_cast<int (*)(pthread_t*, const pthread_attr_t*, void* (*)(void*), void*)>(
          dlsym(RTLD_NEXT, "pthread_create"));
  ++threads;
  return next(thread, attributes, run, of);
}

template <class Base>
static bool caught() {
  try {
    burrlab::Burr(-1.0);
  } catch (const Base& error) {
    return std::string(error.what()).find("radius must be positive") == 0;
  }
  return false;
}

int main() {
  using namespace burrlab;
  const auto bone = std::make_shared<VoxelBone>(Index3{15, 30, 70}, std::uint8_t(255), Vec3(0.2, 0.2, 0.2),
                                                Vec3(-6.9, -2.9, -2.9));
  HostSettings settings;
  settings.to_bone = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
  settings.seed = 5;
  HostBurr burr(bone, Burr(2.0), paper_material("bone"), settings);
  double sum = 0.0;
  const long allocated = allocations, locked = locks, begun = threads;
  const std::clock_t start = std::clock();
  for (int i = 0; i < 100000; ++i) {
    const Vec3 center(-4.0 + i / 16384.0, (i & 1023) / 2048.0, 2.0 - (i & 4095) / 4096.0);
    sum += burr.step(center, 1.0, true).force[2];
    burr.lift();
  }
  const double seconds = double(std::clock() - start) / CLOCKS_PER_SEC;
  const bool quiet = allocations == allocated && locks == locked && threads == begun;
  const bool errors = caught<Error>() && caught<std::invalid_argument>() && caught<InvalidArgument>();
  {
    std::mutex seen;
    std::lock_guard<std::mutex> lock(seen);
  }  // the counter counts
  std::printf("%s %a %.4f\n", bone->digest().c_str(), sum, seconds);
  if (!quiet) std::puts("a tick allocated, locked or began a thread");
  if (!errors) std::puts("an error was not caught");
  return !quiet || !errors || locks == locked;
}
