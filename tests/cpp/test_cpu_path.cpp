// The choice of the tick's code.
#include "burrlab/cpu_path.hpp"

#include <algorithm>
#include <set>

#include "burrlab/tick.hpp"
#include "check.hpp"

using namespace burrlab;

int main() {
  const std::vector<std::string> paths = cpu_paths();
  CHECK(!paths.empty());
  CHECK(std::set<std::string>(paths.begin(), paths.end()).size() == paths.size());
  CHECK(std::count(paths.begin(), paths.end(), "portable") == 1);
  const std::string before = cpu_path();
  CHECK(std::count(paths.begin(), paths.end(), before) == 1);

  std::vector<std::uint16_t> first;
  for (const std::string& path : paths) {
    use_cpu_path(path);
    CHECK(cpu_path() == path);
    const auto drawn = random_field({3, 13, 21}, 0x9E3779B97F4A7C15u, 0x243F6A8885A308D3u, 5, 1);
    CHECK(drawn.size() == 3 * 13 * 21);
    if (first.empty()) first = drawn;
    CHECK(drawn == first);
  }

  return check::report();
}
