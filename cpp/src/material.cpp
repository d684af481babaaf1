#include "burrlab/material.hpp"

#include <utility>

#include "require.hpp"

namespace burrlab {

Burr::Burr(double radius_) : radius(radius_) { require_positive("radius", radius); }

Material::Material(std::string name_, double c_e_, double alpha_, Shape shape_, std::string source_,
                   double force_exponent_, double rate_exponent_)
    : name(std::move(name_)),
      c_e(c_e_),
      alpha(alpha_),
      shape(std::move(shape_)),
      source(std::move(source_)),
      force_exponent(force_exponent_),
      rate_exponent(rate_exponent_) {
  require_positive("c_e", c_e);
  require_not_negative("alpha", alpha);
  if (!(force_exponent >= 1.0 && force_exponent <= largest_exponent))
    refuse("force_exponent", "1 to 8", force_exponent);
  if (!(rate_exponent >= 0.0 && rate_exponent <= largest_exponent))
    refuse("rate_exponent", "0 to 8", rate_exponent);
}

bool Material::operator==(const Material& o) const {
  return name == o.name && c_e == o.c_e && alpha == o.alpha && shape == o.shape && source == o.source &&
         force_exponent == o.force_exponent && rate_exponent == o.rate_exponent;
}

Scheme parse_scheme(const std::string& name) {
  if (name == "layer") return Scheme::layer;
  if (name == "cell") return Scheme::cell;
  throw std::invalid_argument("scheme must be layer or cell, got '" + name + "'");
}

}  // namespace burrlab
