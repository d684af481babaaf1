#include "burrlab/force.hpp"

#include <algorithm>
#include <cmath>

#include "portable_math.hpp"
#include "require.hpp"
#include "standard_arithmetic.hpp"
#include "tick.hpp"

namespace burrlab {

// u from m in [0, 4/3], without libm. Four Newton steps reach double precision for m <= 2/3. Above, the cap
// is the complement of another (equal to 9e-14).
static double relative_penetration(double m) {
  if (m > 2.0 / 3.0) return 2.0 - relative_penetration(4.0 / 3.0 - m);
  const double root = std::sqrt(m), a = root / 3.0;
  double s = 1.0;
  for (int i = 0; i < 4; ++i) s = s - (s * s * (1.0 - a * s) - 1.0) / (s * (2.0 - 3.0 * a * s));
  return root * s;
}

static double depth_of(double m0, double radius) {
  require_not_negative("m0", m0);
  require_positive("radius", radius);
  if (m0 == 0.0) return 0.0;
  return relative_penetration(std::min(m0 / (pi * radius * radius * radius), 4.0 / 3.0)) * radius;  // Eq. 2
}

double penetration(double m0, double radius) {
  const StandardArithmetic arithmetic;
  return depth_of(m0, radius);
}

// u^q; q = 3/2 by the root.
static double raised(double u, double q) {
  return q == Material::paper_force_exponent ? u * std::sqrt(u) : portable::power(u, q);
}

ElasticForce elastic_force(const Moments& moments, double radius, double c_e, double force_exponent) {
  const StandardArithmetic arithmetic;
  return force_of(moments, radius, c_e, force_exponent);
}

ElasticForce force_of(const Moments& moments, double radius, double c_e, double force_exponent) {
  ElasticForce result;
  require_positive("c_e", c_e);
  if (!(force_exponent >= 1.0 && force_exponent <= Material::largest_exponent))
    refuse("force_exponent", "1 to 8", force_exponent);
  result.penetration = depth_of(moments.m0, radius);
  const Vec3& m1 = moments.m1;
  const double length = std::sqrt(m1[0] * m1[0] + m1[1] * m1[1] + m1[2] * m1[2]);
  require_finite("m1", length);
  if (moments.m0 <= 0.0) return result;
  const double floor = fading_asymmetry * moments.m0 * radius;
  result.ambiguous = length < floor;
  const double u = result.penetration / radius, scale = std::max(length, floor);
  result.magnitude = c_e * radius * radius * raised(u, force_exponent);  // Eq. 3
  for (int axis = 0; axis < 3; ++axis) {
    result.normal[axis] = -m1[axis] / scale;
    result.force[axis] = result.magnitude * result.normal[axis];
  }
  return result;
}

}  // namespace burrlab
