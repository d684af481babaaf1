// The erosion shape function f(x), x = r/R, of Eq. 4. The paper asks only for a maximum at r = 0 and zero
// beyond R. The family is our choice; an alpha belongs to one f.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "burrlab/portable_math.hpp"

namespace burrlab {

class Shape {
 public:
  /// f = y^order, where y is 1, the depth delta = 1 - x, or 1 - x^2.
  enum class Kind { constant, linear, power };

  /// The shape of one of `names()`, or of "power(k)", (1 - x^2)^k with 0 < k <= 8; throws
  /// std::invalid_argument.
  static Shape parse(const std::string& name);
  static Shape parabolic() { return Shape(Kind::power, 1.0); }
  static std::vector<std::string> names();

  Kind kind() const { return kind_; }
  /// Order of the zero of f at x = 1; 0 for constant.
  double order() const { return order_; }
  /// Factor of the leading term at the surface: f = kappa delta^order + ...
  double kappa() const { return kind_ == Kind::power ? std::pow(2.0, order_) : 1.0; }
  int whole() const { return whole_; }  ///< the order if it is a whole number, else 0
  std::string name() const;

  /// f at the depth delta = d/R = 1 - x in [0, 1] below the sphere's surface. In the tick Real is float.
  template <class Real>
  Real at_depth(Real delta) const {
    if (kind_ == Kind::constant) return Real(1);
    return raise(kind_ == Kind::linear ? delta : delta * (Real(2) - delta));
  }

  /// f at radius x = r/R >= 0; zero beyond 1.
  template <class Real>
  Real at_radius(Real x) const {
    if (x > Real(1)) return Real(0);
    if (kind_ == Kind::constant) return Real(1);
    return raise(Real(1) - (kind_ == Kind::linear ? x : x * x));
  }

  bool operator==(const Shape& other) const { return kind_ == other.kind_ && order_ == other.order_; }

 private:
  Shape(Kind kind, double order)
      : kind_(kind), order_(order), whole_(order == static_cast<int>(order) ? static_cast<int>(order) : 0) {}

  template <class Real>
  Real raise(Real y) const {  // y^order
    if (whole_ == 0) return static_cast<Real>(portable::pow(static_cast<double>(y), order_));
    Real result = y;
    for (int i = 1; i < whole_; ++i) result *= y;
    return result;
  }

  Kind kind_;
  double order_;
  int whole_;
};

}  // namespace burrlab
