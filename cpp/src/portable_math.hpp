// exp, log and pow from + - * / and bits alone, for what decides bits of the erosion. The C library's
// versions differ in the last bit between CPUs and releases. Many go side by side: each is a long chain of
// divisions.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace burrlab::portable {

/// Adding it leaves a whole number, to the nearest and even, in the low bits of the sum; |x| < 2^51.
constexpr double to_whole = 0x1.8p52;

template <class To, class From>
inline To with_bits_of(From from) {
  To to;
  std::memcpy(&to, &from, sizeof to);
  return to;
}

/// 2^k of a whole k in -1022..1023.
inline double two_to(double k) {
  return with_bits_of<double>(with_bits_of<std::uint64_t>(k + 1023.0 + to_whole) << 52);
}

/// e^x of each, relative error below 1e-15 for |x| < 700.
template <std::size_t n>
inline std::array<double, n> exp(const std::array<double, n>& x) {
  constexpr double ln2_high = 0.693147180369123816490, ln2_low = 1.90821492927058770002e-10;
  std::array<double, n> twos, r, sum;
  for (std::size_t i = 0; i < n; ++i) {
    const double at = std::min(std::max(x[i], -746.0), 1100.0);  // beyond both ends 0 and infinity
    twos[i] = (at * 1.44269504088896338700 + to_whole) - to_whole;
    r[i] = (at - twos[i] * ln2_high) - twos[i] * ln2_low;  // |r| <= ln(2)/2
    sum[i] = 1.0;
  }
#pragma GCC unroll 16  // so that a division by a power of two is a product, of the same bits
  for (int k = 16; k >= 1; --k) {
#pragma GCC unroll 1
    for (std::size_t i = 0; i < n; ++i) sum[i] = 1.0 + sum[i] * r[i] / k;
  }
  for (std::size_t i = 0; i < n; ++i) {
    const double half = (0.5 * twos[i] + to_whole) - to_whole;  // a product that is subnormal is rounded once
    sum[i] = x[i] < -745.0 ? 0.0 : sum[i] * two_to(half) * two_to(twos[i] - half);
  }
  return sum;
}
inline double exp(double x) { return exp(std::array<double, 1>{x})[0]; }

/// Natural logarithm of each x > 0, relative error below 1e-15.
template <std::size_t n>
inline std::array<double, n> log(const std::array<double, n>& x) {
  std::array<double, n> y;
  for (std::size_t i = 0; i < n; ++i) {
    const bool subnormal = x[i] < 0x1p-1022;
    const std::uint64_t bits = with_bits_of<std::uint64_t>(subnormal ? x[i] * 0x1p54 : x[i]);
    const double biased = with_bits_of<double>((bits >> 52) | 0x4330000000000000) - 0x1p52;
    const double half_to_1 = with_bits_of<double>((bits & 0xfffffffffffff) | 0x3fe0000000000000);
    const bool low = half_to_1 < 0.70710678118654752;
    const double m = low ? 2.0 * half_to_1 : half_to_1;
    const double twos = biased - (subnormal ? 1076.0 : 1022.0) - (low ? 1.0 : 0.0);
    const double z = (m - 1.0) / (m + 1.0), z2 = z * z;  // |z| < 0.172
    double sum = 0.0;
#pragma GCC unroll 12
    for (int k = 23; k >= 1; k -= 2) sum = sum * z2 + 1.0 / k;
    y[i] = 2.0 * z * sum + twos * 0.693147180559945309417;
  }
  return y;
}
inline double log(double x) { return log(std::array<double, 1>{x})[0]; }

/// x^k of each x >= 0, k > 0.
template <std::size_t n>
inline std::array<double, n> pow(const std::array<double, n>& x, double k) {
  std::array<double, n> y = log(x);
  for (double& each : y) each *= k;
  y = exp(y);
  for (std::size_t i = 0; i < n; ++i) y[i] = x[i] > 0.0 ? y[i] : 0.0;
  return y;
}
inline double pow(double x, double k) { return pow(std::array<double, 1>{x}, k)[0]; }

/// x^k for x >= 0, k > 0: a product for whole k, else `pow`.
inline double power(double x, double k) {
  const int whole = static_cast<int>(k);
  if (whole != k) return pow(x, k);
  double product = x;
  for (int i = 1; i < whole; ++i) product *= x;
  return product;
}

}  // namespace burrlab::portable
