// The erosion shape function f(x), x = r/R, of Eq. 4. The paper asks only for a maximum at r = 0 and zero
// beyond R; the family is our choice, and an alpha is a number for one f.
#pragma once

#include <string>

#include "burrlab/portable_math.hpp"

namespace burrlab {

class Shape {
 public:
  enum class Kind { constant, linear, power };

  static Shape constant() { return Shape(Kind::constant, 0.0); }  ///< f = 1
  static Shape linear() { return Shape(Kind::linear, 1.0); }      ///< f = 1 - x
  static Shape power(double k);                                   ///< f = (1 - x^2)^k, 0 < k <= 8
  static Shape parabolic() { return power(1.0); }                 ///< f = 1 - x^2
  static Shape quartic() { return power(2.0); }                   ///< f = (1 - x^2)^2
  /// From "parabolic", "linear", "quartic", "constant" or "power(k)"; throws std::invalid_argument.
  static Shape parse(const std::string& name);

  Kind kind() const { return kind_; }
  /// Order of the zero of f at x = 1: 0 for constant, 1 for linear, k for power(k).
  double order() const { return order_; }
  int whole() const { return whole_; }  ///< the exponent k where it is a whole number, else 0
  std::string name() const;

  /// f at depth d below the sphere's surface, delta = d/R = 1 - x in [0, 1]. In the tick Real is float.
  template <class Real>
  Real at_depth(Real delta) const {
    switch (kind_) {
      case Kind::constant:
        return Real(1);
      case Kind::linear:
        return delta;
      default:
        return raise(delta * (Real(2) - delta));
    }
  }

  /// f at radius x = r/R >= 0; zero beyond 1.
  template <class Real>
  Real at_radius(Real x) const {
    if (x > Real(1)) return Real(0);
    switch (kind_) {
      case Kind::constant:
        return Real(1);
      case Kind::linear:
        return Real(1) - x;
      default:
        return raise(Real(1) - x * x);
    }
  }

  bool operator==(const Shape& other) const { return kind_ == other.kind_ && order_ == other.order_; }

 private:
  Shape(Kind kind, double order)
      : kind_(kind), order_(order), whole_(order == static_cast<int>(order) ? static_cast<int>(order) : 0) {}

  template <class Real>
  Real raise(Real y) const {  // y^k
    if (whole_ == 0) return static_cast<Real>(portable::pow(static_cast<double>(y), order_));
    Real result = y;
    for (int i = 1; i < whole_; ++i) result *= y;
    return result;
  }

  Kind kind_;
  double order_;
  int whole_;  // the exponent where it is a whole number, else 0
};

}  // namespace burrlab
