#include "burrlab/material.hpp"

#include <utility>

#include "require.hpp"

namespace burrlab {

Burr::Burr(double radius_) : radius(radius_) {
  require_positive("radius", radius);
  if (radius > 1e6) refuse("radius", "at most 1e6 mm", radius);  // powers of it must be finite
}

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
  if (c_e > 1e12) refuse("c_e", "at most 1e12 N/mm^2", c_e);  // forces must be finite
  if (!(force_exponent >= 1.0 && force_exponent <= largest_exponent))
    refuse("force_exponent", "1 to 8", force_exponent);
  if (!(rate_exponent >= 0.0 && rate_exponent <= largest_exponent))
    refuse("rate_exponent", "0 to 8", rate_exponent);
}

bool Material::operator==(const Material& o) const {
  return name == o.name && c_e == o.c_e && alpha == o.alpha && shape == o.shape && source == o.source &&
         force_exponent == o.force_exponent && rate_exponent == o.rate_exponent;
}

const std::vector<Material>& paper_materials() {
  static const std::vector<Material> materials = [] {
    const std::string paper = "Agus et al., HAPTICS 2004, section 4.2: ";
    const std::string unknown =
        "; the paper's f and voxel size are unknown; alpha holds for one drill, burr type and speed";
    const auto material = [&](const char* name, double c_e, double alpha, const char* how) {
      return Material(name, c_e, alpha, Shape::parabolic(), paper + how + unknown);
    };
    return std::vector<Material>{material("bone", 2.145, 0.087, "fitted, mastoid bone"),
                                 material("pettigrew", 1.504, 0.116, "fitted, Pettigrew resin"),
                                 material("pvc", 0.462, 0.256, "fitted, PVC K70"),
                                 material("expert", 1.5, 0.1, "set by expert surgeons")};
  }();
  return materials;
}

const Material& paper_material(const std::string& name) {
  std::string known;
  for (const Material& material : paper_materials()) {
    if (name == material.name) return material;
    known += (known.empty() ? "" : ", ") + material.name;
  }
  throw InvalidArgument("material must be one of " + known + ", got '" + name + "'");
}

Scheme parse_scheme(const std::string& name) {
  if (name == "layer") return Scheme::layer;
  if (name == "cell") return Scheme::cell;
  throw InvalidArgument("scheme must be layer or cell, got '" + name + "'");
}

}  // namespace burrlab
