#include "burrlab/shape.hpp"

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <locale>
#include <sstream>

#include "portable_math.hpp"
#include "require.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {

namespace {

/// A new shape of these kinds is a row here, in tests/reference/tick.py and in docs/model.md.
struct Named {
  const char* name;
  Shape::Kind kind;
  double order;
};
constexpr Named named[] = {{"parabolic", Shape::Kind::power, 1.0},
                           {"linear", Shape::Kind::linear, 1.0},
                           {"quartic", Shape::Kind::power, 2.0},
                           {"constant", Shape::Kind::constant, 0.0}};

constexpr double closest = 1e-6;  // of two x of a table, so that they differ in single precision too
constexpr double least = 1e-9;    // of f over f(0) that is not zero

bool read(const std::string& number, double& value) {
  std::istringstream text(number);
  text.imbue(std::locale::classic());
  return number.find_first_not_of("0123456789.eE+-") == std::string::npos && text >> value && text.eof();
}

/// The shortest text that gives the same number.
std::string written(double value) {
  const StandardEnvironment environment;
  for (int digits = 1;; ++digits) {
    std::ostringstream text;
    text.imbue(std::locale::classic());
    text.precision(digits);
    text << value;
    double again = 0.0;
    if (digits == 17 || (read(text.str(), again) && again == value)) return text.str();
  }
}

/// "table(k;x:f,x:f,...)".
Shape read_table(const std::string& name) {
  const auto malformed = [&] {
    return InvalidArgument("a table must read table(k;x:f,x:f,...), got '" + name + "'");
  };
  std::istringstream rows(name.substr(6, name.size() - 7));
  std::string part;
  double order = 0.0;
  if (name.back() != ')' || !std::getline(rows, part, ';') || !read(part, order)) throw malformed();
  std::vector<double> x, f;
  while (std::getline(rows, part, ',')) {
    const std::size_t colon = part.find(':');
    x.push_back(0.0);
    f.push_back(0.0);
    if (colon == std::string::npos || !read(part.substr(0, colon), x.back()) ||
        !read(part.substr(colon + 1), f.back()))
      throw malformed();
  }
  return Shape::from_table(x, f, order);
}

/// Order of the zero of f at x = 1: the slope of log f over log delta, extrapolated to delta = 0 from the
/// last two. Within that step of a whole number, or 0.1, it is that number, else the next multiple of 0.05.
/// Three points, or slopes that differ much, give the whole number next to the last slope.
double order_at_end(const std::vector<double>& x, const std::vector<double>& f) {
  const auto depth = [&](std::size_t i) { return 1.0 - x[i]; };
  const auto slope = [&](std::size_t i) {
    return std::log(f[i - 1] / f[i]) / std::log(depth(i - 1) / depth(i));
  };
  const auto middle = [&](std::size_t i) { return std::sqrt(depth(i - 1) * depth(i)); };
  const std::size_t i = x.size() - 2;
  const double near = slope(i);
  double order = std::max(std::rint(near), 1.0);
  if (i > 1) {
    const double step = middle(i) * (near - slope(i - 1)) / (middle(i - 1) - middle(i)), limit = near + step;
    if (std::abs(step) <= 0.7 && limit >= 0.25) {
      const bool whole = std::abs(limit - std::rint(limit)) <= std::max(std::abs(step), 0.1);
      order = whole ? std::max(std::rint(limit), 1.0) : std::rint(20.0 * limit) / 20.0;
    }
  }
  return std::min(order, 8.0);
}

}  // namespace

std::vector<std::string> Shape::names() {
  std::vector<std::string> names;
  for (const Named& row : named) names.emplace_back(row.name);
  return names;
}

Shape Shape::parse(const std::string& name) {
  const StandardEnvironment environment;
  std::string known;
  for (const Named& row : named) {
    if (name == row.name) return Shape(row.kind, row.order);
    known += (known.empty() ? "" : ", ") + std::string(row.name);
  }
  if (name.rfind("table(", 0) == 0) return read_table(name);
  if (name.size() > 7 && name.rfind("power(", 0) == 0 && name.back() == ')') {
    double k = 0.0;
    if (read(name.substr(6, name.size() - 7), k)) {
      if (!(k >= 1e-6 && k <= 8.0)) refuse("k of power(k)", "1e-6 to 8", k);
      return Shape(Kind::power, k);
    }
  }
  throw InvalidArgument("shape must be " + known + " or power(k), got '" + name + "'");
}

Shape Shape::from_table(const std::vector<double>& x, const std::vector<double>& f, double order) {
  const StandardArithmetic arithmetic;
  const std::size_t n = x.size(), last = n - 1;
  if (f.size() != n) refuse("f", "as long as x, " + std::to_string(n), static_cast<double>(f.size()));
  if (n < Table::fewest || n > Table::most) refuse("points of a table", "3 to 256", static_cast<double>(n));
  for (std::size_t i = 0; i < n; ++i) {
    require_finite("every x of a table", x[i]);
    require_finite("every f of a table", f[i]);
    if (i > 0 && !(x[i] - x[i - 1] >= closest)) refuse("x of a table", "rising by 1e-6 or more", x[i]);
    if (f[i] > f[0]) refuse("f of a table", "at most f(0) = " + written(f[0]) + ", its maximum", f[i]);
    if (f[i] < 0.0) refuse("f of a table", "zero or positive", f[i]);
    if (i < last && !(f[i] > least * f[0])) refuse("f of a table", "above 1e-9 f(0) below x = 1", f[i]);
  }
  if (x[0] != 0.0) refuse("the first x of a table", "0", x[0]);
  if (x[last] != 1.0) refuse("the last x of a table", "1", x[last]);

  Table table;
  const bool zero = f[last] <= least * f[0];
  if (std::isnan(order) && zero) order = order_at_end(x, f);
  if (std::isnan(order)) order = 0.0;
  if (zero && !(order > 0.0 && order <= 8.0)) refuse("order of a table with f(1) = 0", "in (0, 8]", order);
  if (!zero && order != 0.0) refuse("order of a table with f(1) above 0", "0", order);
  table.name = "table(" + written(order);
  for (std::size_t i = 0; i < n; ++i) {
    const double ratio = i == last && zero ? 0.0 : f[i] / f[0];
    table.name += (i == 0 ? ";" : ",") + written(x[i] + 0.0) + ":" + written(ratio);
    table.depth.push_back(1.0 - x[i]);
    table.value.push_back(zero && order != 1.0 ? portable::pow(ratio, 1.0 / order) : ratio);
    if (ratio > 0.0 && table.value.back() < std::numeric_limits<float>::min())
      refuse("order of a table", "larger, for its f of " + written(ratio), order);
  }
  table.name += ")";
  std::reverse(table.depth.begin(), table.depth.end());
  std::reverse(table.value.begin(), table.value.end());
  const std::vector<double>&d = table.depth, &value = table.value;
  for (std::size_t i = 0; i < last; ++i) table.slope.push_back((value[i + 1] - value[i]) / (d[i + 1] - d[i]));
  table.slope.push_back(0.0);
  std::size_t size = 4;
  while (size < n) size *= 2;
  table.nodes.assign(3 * size, std::numeric_limits<float>::max());
  for (std::size_t i = 0; i < n; ++i) {
    table.nodes[i] = static_cast<float>(d[i]);
    table.nodes[size + i] = static_cast<float>(value[i]);
    table.nodes[2 * size + i] = static_cast<float>(table.slope[i]);
  }
  Shape shape(Kind::table, order);
  shape.table_ = std::make_shared<const Table>(std::move(table));
  return shape;
}

double Shape::Table::at(double delta) const {
  const std::size_t i =
      static_cast<std::size_t>(std::upper_bound(depth.begin() + 1, depth.end(), delta) - depth.begin()) - 1;
  return value[i] + (delta - depth[i]) * slope[i];
}

Shape::Shape(Kind kind, double order)
    : kind_(kind), order_(order), whole_(order == static_cast<int>(order) ? static_cast<int>(order) : 0) {}

double Shape::at_depth(double delta) const {
  if (kind_ == Kind::constant) return 1.0;
  if (kind_ == Kind::table) return order_ == 0.0 ? table_->at(delta) : to_order(table_->at(delta));
  return to_order(kind_ == Kind::linear ? delta : delta * (2.0 - delta));
}

double Shape::at_radius(double x) const {
  if (x > 1.0) return 0.0;
  if (kind_ == Kind::constant || kind_ == Kind::table) return at_depth(1.0 - x);
  return to_order(1.0 - (kind_ == Kind::linear ? x : x * x));
}

double Shape::to_order(double y) const {
  if (whole_ == 0) return portable::pow(y, order_);
  double power = y;
  for (int i = 1; i < whole_; ++i) power *= y;
  return power;
}

double Shape::kappa() const {
  if (!table_) return kind_ == Kind::power ? std::pow(2.0, order_) : 1.0;
  return order_ == 0.0 ? table_->value[0] : std::pow(table_->slope[0], order_);
}

std::string Shape::name() const {
  if (table_) return table_->name;
  for (const Named& row : named)
    if (kind_ == row.kind && order_ == row.order) return row.name;
  return "power(" + written(order_) + ")";
}

std::string Shape::label() const {
  if (!table_) return name();
  std::uint32_t digest = 2166136261u;  // FNV-1a
  for (const char letter : table_->name) digest = (digest ^ static_cast<unsigned char>(letter)) * 16777619u;
  char text[80];
  std::snprintf(text, sizeof text, "table(%zu points, order %s, %08x)", table_->depth.size(),
                written(order_).c_str(), static_cast<unsigned>(digest));
  return text;
}

}  // namespace burrlab
