#include "burrlab/shape.hpp"

#include <locale>
#include <sstream>
#include <stdexcept>

#include "burrlab/check.hpp"

namespace burrlab {

Shape Shape::power(double k) {
  if (!(k > 0.0 && k <= 8.0)) refuse("k of power(k)", "in (0, 8]", k);
  return Shape(Kind::power, k);
}

Shape Shape::parse(const std::string& name) {
  if (name == "constant") return constant();
  if (name == "linear") return linear();
  if (name == "parabolic") return parabolic();
  if (name == "quartic") return quartic();
  if (name.size() > 7 && name.rfind("power(", 0) == 0 && name.back() == ')') {
    const std::string number = name.substr(6, name.size() - 7);
    std::istringstream text(number);
    text.imbue(std::locale::classic());
    double k = 0.0;
    if (number.find_first_not_of("0123456789.eE+-") == std::string::npos && text >> k && text.eof())
      return power(k);
  }
  throw std::invalid_argument("shape must be parabolic, linear, quartic, constant or power(k), got '" + name +
                              "'");
}

std::string Shape::name() const {
  if (kind_ == Kind::constant) return "constant";
  if (kind_ == Kind::linear) return "linear";
  if (order_ == 1.0) return "parabolic";
  if (order_ == 2.0) return "quartic";
  for (int digits = 1;; ++digits) {  // the shortest text that reads back as the same number
    std::ostringstream text;
    text.imbue(std::locale::classic());
    text.precision(digits);
    text << order_;
    if (digits == 17 || std::stod(text.str()) == order_) return "power(" + text.str() + ")";
  }
}

}  // namespace burrlab
