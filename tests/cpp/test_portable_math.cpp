// exp, log and pow from + - * / against the C library.
#include "portable_math.hpp"

#include "check.hpp"

namespace portable = burrlab::portable;

int main() {
  for (double x = -700.0; x < 700.0; x += 0.37) CHECK_NEAR(portable::exp(x) / std::exp(x), 1.0, 1e-15);
  for (double x = 1e-300; x < 1e300; x *= 1.37) {
    CHECK_NEAR(portable::log(x), std::log(x), 1e-15 * std::abs(std::log(x)));
  }
  for (double x = 0.5; x < 2.0; x += 0.0011) {
    CHECK_NEAR(portable::log(x), std::log(x), 1e-15 * std::abs(std::log(x)));  // zero near 1
  }
  for (double x = 0.001; x <= 4.0; x += 0.0173) {
    for (const double k : {0.1, 0.5, 1.5, 7.3, 9.0}) {
      CHECK_NEAR(portable::pow(x, k) / std::pow(x, k), 1.0, 2e-14);
    }
  }
  for (const double x : {5e-324, 1e-310}) CHECK_NEAR(portable::log(x), std::log(x), 1e-12);
  CHECK_NEAR(portable::exp(-740.0), std::exp(-740.0), 1e-323);  // subnormal
  CHECK(portable::exp(0.0) == 1.0);
  CHECK(portable::exp(-800.0) == 0.0);
  for (const double x : {709.9, 800.0, 1e6, 1e300}) CHECK(std::isinf(portable::exp(x)));
  CHECK(std::isinf(portable::pow(1e300, 2.5)));
  CHECK(portable::log(1.0) == 0.0);
  CHECK(portable::pow(0.0, 1.5) == 0.0);
  CHECK(portable::pow(1.0, 1.5) == 1.0);
  return check::report();
}
