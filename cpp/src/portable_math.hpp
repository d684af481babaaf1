// exp, log and pow from + - * / alone, for tables that decide bits of the erosion. The C library's versions
// differ in the last bit between CPUs and releases. frexp, ldexp and rint are exact.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace burrlab::portable {

/// e^x of each, relative error below 1e-15 for |x| < 700; side by side, as each is a long chain of divisions.
template <std::size_t n>
inline std::array<double, n> exp(const std::array<double, n>& x) {
  constexpr double ln2_high = 0.693147180369123816490, ln2_low = 1.90821492927058770002e-10;
  std::array<double, n> twos, r, sum;
  for (std::size_t i = 0; i < n; ++i) {
    const double at = std::max(x[i], -746.0);
    twos[i] = std::rint(at * 1.44269504088896338700);
    r[i] = (at - twos[i] * ln2_high) - twos[i] * ln2_low;  // |r| <= ln(2)/2
    sum[i] = 1.0;
  }
#pragma GCC unroll 16  // so that a division by a power of two is a product, of the same bits
  for (int k = 16; k >= 1; --k)
    for (std::size_t i = 0; i < n; ++i) sum[i] = 1.0 + sum[i] * r[i] / k;
  for (std::size_t i = 0; i < n; ++i)
    sum[i] = x[i] < -745.0 ? 0.0 : std::ldexp(sum[i], static_cast<int>(twos[i]));
  return sum;
}
inline double exp(double x) { return exp(std::array<double, 1>{x})[0]; }

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

/// x^k for x >= 0, k > 0: a product for whole k, else `pow`.
inline double power(double x, double k) {
  const int whole = static_cast<int>(k);
  if (whole != k) return pow(x, k);
  double product = x;
  for (int i = 1; i < whole; ++i) product *= x;
  return product;
}

}  // namespace burrlab::portable
