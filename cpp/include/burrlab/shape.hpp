// The erosion shape function f(x), x = r/R, of Eq. 4. The paper asks only for a maximum at r = 0 and zero
// beyond R. The family is our choice; an alpha belongs to one f.
//
//     const burrlab::Shape f = burrlab::Shape::parse("power(1.5)");
//     const double half_way = f.at_radius(0.5);  // 0.75^1.5
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "burrlab/error.hpp"

namespace burrlab {

/// An erosion shape f.
class BURRLAB_API Shape {
 public:
  /// f = y^order, where y is 1, the depth delta = 1 - x, 1 - x^2, or a table over the depth.
  enum class Kind { constant, linear, power, table };

  /// y of a table: f^(1/order), or f where f(1) > 0 and the order is 0. Linear between its nodes, which stand
  /// by rising depth; so f lies between its values at the nodes, and ends as delta^order.
  struct Table {
    static constexpr std::size_t fewest = 3;  ///< nodes
    static constexpr std::size_t most = 256;  ///< nodes
    std::vector<double> depth;                ///< delta of each node, rising
    std::vector<double> value;                ///< y there
    std::vector<double> slope;                ///< of y from there to the next node
    std::vector<float> nodes;       ///< depth, value and slope for the tick, each padded to a power of two
    std::string name;               ///< as `Shape::name`
    double at(double delta) const;  ///< y
  };

  /// The shape of one of `names()`, of "power(k)", (1 - x^2)^k with 1e-6 <= k <= 8, or of a table's name;
  /// throws InvalidArgument.
  static Shape parse(const std::string& name);
  /// The table of f at x; `order` is that of the zero at x = 1, NaN to take it from the table's end. Throws
  /// InvalidArgument.
  static Shape from_table(const std::vector<double>& x, const std::vector<double>& f, double order);
  static Shape parabolic() { return Shape(Kind::power, 1.0); }  ///< 1 - x^2
  static std::vector<std::string> names();                      ///< that `parse` takes

  Kind kind() const { return kind_; }  ///< of its y
  /// Order of the zero of f at x = 1; 0 for constant.
  double order() const { return order_; }
  /// Factor of the leading term at the surface: f = kappa delta^order + ...
  double kappa() const;
  int whole() const { return whole_; }  ///< the order if it is a whole number, else 0
  /// The order whose effective depth `layer` takes; that of a table with f(1) > 0 is of what f adds to f(1).
  double layer_order() const { return table_ && order_ == 0.0 ? 1.0 : order_; }
  const Table* table() const { return table_.get(); }  ///< null for the other kinds
  std::string name() const;   ///< `parse` gives the same shape to the bit: that of a table holds its numbers
  std::string label() const;  ///< the name, or for a table a short one with a digest

  /// f at the depth delta = d/R = 1 - x in [0, 1] below the sphere's surface, in the caller's rounding mode.
  double at_depth(double delta) const;
  double at_radius(double x) const;  ///< f at x = r/R >= 0, zero beyond 1, in the caller's rounding mode

  bool operator==(const Shape& other) const {
    return kind_ == other.kind_ && order_ == other.order_ && (!table_ || table_->name == other.table_->name);
  }

 private:
  Shape(Kind kind, double order);
  double to_order(double y) const;  // y^order

  Kind kind_;
  double order_;
  int whole_;
  std::shared_ptr<const Table> table_;
};

}  // namespace burrlab
