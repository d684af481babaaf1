// A spherical burr, and a material: its elastic constant, erosion rate and erosion shape.
#pragma once

#include <string>
#include <utility>

#include "burrlab/check.hpp"
#include "burrlab/shape.hpp"

namespace burrlab {

struct Burr {
  double radius;  ///< [mm]

  explicit Burr(double radius_mm) : radius(radius_mm) { require_positive("radius", radius); }
  bool operator==(const Burr& other) const { return radius == other.radius; }
};

struct Material {
  std::string name;
  double c_e;          ///< elastic constant [N/mm^2], Eq. 3
  double alpha;        ///< erosion rate [1/ms], Eq. 4; for one f, drill, burr type and speed
  Shape shape;         ///< erosion shape function f of Eq. 4
  std::string source;  ///< source of the numbers

  Material(std::string name_, double c_e_, double alpha_, Shape shape_, std::string source_)
      : name(std::move(name_)), c_e(c_e_), alpha(alpha_), shape(shape_), source(std::move(source_)) {
    require_positive("c_e", c_e);
    require_not_negative("alpha", alpha);
  }
  bool operator==(const Material& o) const {
    return name == o.name && c_e == o.c_e && alpha == o.alpha && shape == o.shape && source == o.source;
  }
};

}  // namespace burrlab
