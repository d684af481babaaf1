// Parts of the tick; tests/python/test_tick_reference.py has the whole, bit for bit, on every CPU path.
#include <cmath>

#include "check.hpp"
#include "depth_table.hpp"
#include "eroded_fraction.hpp"

using namespace burrlab;

namespace {

void check_eroded_fraction() {
  for (double a = 1e-6; a < 40.0; a *= 1.3) {
    const ErodedFraction fraction(a);
    CHECK(fraction.scale <= 0.125f);
    for (const float f : {0.0f, 0.1f, 0.5f, 1.0f}) {
      const float y = fraction.scale * f;
      float p = y * (1.0f - y * (fraction.c1 - y * (fraction.c2 - y * fraction.c3)));
      for (int i = 0; i < fraction.doublings; ++i) p = p * (2.0f - p);
      CHECK_NEAR(p, -std::expm1(-a * f), 4e-7 * -std::expm1(-a * f));
    }
  }
  CHECK(ErodedFraction(0.125).doublings == 0 && ErodedFraction(0.13).doublings == 1);
}

}  // namespace

int main() {
  check_eroded_fraction();
  CHECK(DepthTable::of_order(2.0) == DepthTable::of_order(2.0));  // shared
  return check::report();
}
