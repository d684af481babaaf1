// The part of a mass that erodes in one tick: the integral of Eq. 4.
#pragma once

namespace burrlab {

/// 1 - exp(-a f), a = alpha dt, as a short polynomial of y = a f 2^-k, y (1 - y (c1 - y (c2 - y c3))),
/// doubled k times: p becomes p (2 - p).
struct ErodedFraction {
  /// The best coefficients for a f 2^-k in 0..1/8: relative error 2e-8.
  static constexpr float c1 = 0.49999714f, c2 = 0.16652727f, c3 = 0.03972289f;

  float scale = 0.0f;  ///< a 2^-k <= 1/8
  int doublings = 0;   ///< k

  explicit ErodedFraction(double a) {
    for (; a > 0.125; a *= 0.5) ++doublings;
    scale = static_cast<float>(a);
  }
};

}  // namespace burrlab
