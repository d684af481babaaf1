// The benchmark's library for ctypes: the plain tick and the machine. Ticks are timed in C++, without Python.
// Functions return null or -1 on error; bench_error() gives the reason.

#include "bench_lib.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <vector>

#include "cpu_path.hpp"
#include "plain_tick.hpp"

namespace burrlab::bench {
std::string last_error;
}

using namespace burrlab;
using namespace burrlab::bench;

extern "C" {

const char* bench_error() { return last_error.c_str(); }
const char* bench_compiler() { return BENCH_COMPILER; }
const char* bench_flags() { return BENCH_FLAGS; }

const char* bench_cpu_paths() {
  static std::string names;
  names.clear();
  for (const std::string& name : cpu_paths()) names += (names.empty() ? "" : ",") + name;
  return names.c_str();
}

// G(e, tau) of order 1, (25, 41).
void bench_depth_table(float* out) {
  const auto& nodes = DepthTable::of_order(1.0)->nodes();
  std::memcpy(out, nodes.data(), sizeof(nodes));
}

// n ticks of the plain loop at `centers` (n, 3); seconds (n), interrupted (n), and sums (n, 5): mass, first
// moments (x, y, z), levels lost.
int plain_run(const std::int64_t* shape, std::uint8_t* density, const std::uint8_t* pristine, double spacing,
              const double* origin, double radius, int layer, std::uint64_t seed, std::uint64_t tick,
              double a, const double* centers, std::int64_t n, double* seconds, std::uint8_t* interrupted,
              std::int64_t* sums) {
  return guarded([&] {
    const PlainTick plain(index3(shape), spacing, vec3(origin), radius, layer ? Scheme::layer : Scheme::cell,
                          seed, 0);
    for (std::int64_t i = 0; i < n; ++i) {
      const Vec3 center = vec3(centers + 3 * i);
      const Stopwatch watch;
      const PlainSums found = plain.step(density, pristine, center, a, tick + std::uint64_t(i));
      watch.stop(1.0, seconds + i, interrupted + i);
      const std::int64_t row[5] = {found.mass, found.first[0], found.first[1], found.first[2], found.lost};
      std::copy(row, row + 5, sums + 5 * i);
    }
    return 0;
  });
}

// Bytes per second of the best of `repeats` passes: read, or copied (bytes read and written both count).
double bench_bandwidth(std::int64_t bytes, int repeats, int copy) {
  std::vector<std::uint64_t> from(static_cast<std::size_t>(bytes / 8), 1), to(copy ? from.size() : 0);
  double best = 0.0, seconds = 0.0;
  std::uint8_t interrupted = 0;
  volatile std::uint64_t sink = 0;
  for (int i = 0; i < repeats; ++i) {
    const Stopwatch watch;
    if (copy) {
      std::memcpy(to.data(), from.data(), from.size() * 8);
      sink = to[static_cast<std::size_t>(i) % to.size()];
    } else {
      sink = std::accumulate(from.begin(), from.end(), std::uint64_t{0});
    }
    watch.stop(1.0, &seconds, &interrupted);
    best = std::max(best, static_cast<double>(bytes) * (copy ? 2.0 : 1.0) / seconds);
  }
  (void)sink;
  return best;
}
}
