// A spherical burr.
#pragma once

#include "burrlab/check.hpp"

namespace burrlab {

struct Burr {
  double radius;  ///< [mm]

  explicit Burr(double radius_mm) : radius(radius_mm) { require_positive("radius", radius); }
  bool operator==(const Burr& other) const { return radius == other.radius; }
};

}  // namespace burrlab
