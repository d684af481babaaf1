#include "burrlab/shape.hpp"

#include <locale>
#include <sstream>
#include <stdexcept>

#include "burrlab/check.hpp"

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

}  // namespace

std::vector<std::string> Shape::names() {
  std::vector<std::string> names;
  for (const Named& row : named) names.emplace_back(row.name);
  return names;
}

Shape Shape::parse(const std::string& name) {
  std::string known;
  for (const Named& row : named) {
    if (name == row.name) return Shape(row.kind, row.order);
    known += (known.empty() ? "" : ", ") + std::string(row.name);
  }
  if (name.size() > 7 && name.rfind("power(", 0) == 0 && name.back() == ')') {
    const std::string number = name.substr(6, name.size() - 7);
    std::istringstream text(number);
    text.imbue(std::locale::classic());
    double k = 0.0;
    if (number.find_first_not_of("0123456789.eE+-") == std::string::npos && text >> k && text.eof()) {
      if (!(k > 0.0 && k <= 8.0)) refuse("k of power(k)", "in (0, 8]", k);
      return Shape(Kind::power, k);
    }
  }
  throw std::invalid_argument("shape must be " + known + " or power(k), got '" + name + "'");
}

std::string Shape::name() const {
  for (const Named& row : named)
    if (kind_ == row.kind && order_ == row.order) return row.name;
  for (int digits = 1;; ++digits) {  // the shortest text that gives the same number
    std::ostringstream text;
    text.imbue(std::locale::classic());
    text.precision(digits);
    text << order_;
    if (digits == 17 || std::stod(text.str()) == order_) return "power(" + text.str() + ")";
  }
}

}  // namespace burrlab
