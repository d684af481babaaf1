// exp, log and pow from + - * / alone, for tables that decide bits of the erosion. The C library's versions
// differ in the last bit between CPUs and releases. frexp, ldexp and rint are exact.
#pragma once

#include <cmath>

namespace burrlab::portable {

/// e^x, relative error below 1e-15 for |x| < 700.
inline double exp(double x) {
  if (x < -745.0) return 0.0;
  constexpr double ln2_high = 0.693147180369123816490, ln2_low = 1.90821492927058770002e-10;
  const double n = std::rint(x * 1.44269504088896338700);
  const double r = (x - n * ln2_high) - n * ln2_low;  // |r| <= ln(2)/2
  double sum = 1.0;
  for (int k = 16; k >= 1; --k) sum = 1.0 + sum * r / k;
  return std::ldexp(sum, static_cast<int>(n));
}

/// Natural logarithm of x > 0, relative error below 1e-15.
inline double log(double x) {
  int exponent = 0;
  double mantissa = std::frexp(x, &exponent);  // in [1/2, 1)
  if (mantissa < 0.70710678118654752) {
    mantissa *= 2.0;
    --exponent;
  }
  const double z = (mantissa - 1.0) / (mantissa + 1.0), z2 = z * z;  // |z| < 0.172
  double sum = 0.0;
  for (int k = 23; k >= 1; k -= 2) sum = sum * z2 + 1.0 / k;
  return 2.0 * z * sum + exponent * 0.693147180559945309417;
}

/// x^k for x >= 0, k > 0.
inline double pow(double x, double k) { return x > 0.0 ? exp(k * log(x)) : 0.0; }

}  // namespace burrlab::portable
