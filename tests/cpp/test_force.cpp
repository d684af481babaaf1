// Penetration (Eq. 2) and elastic force (Eq. 3) from moments.
#include "burrlab/force.hpp"

#include "check.hpp"

using burrlab::elastic_force;
using burrlab::ElasticForce;
using burrlab::penetration;
using burrlab::pi;
using burrlab::Vec3;

namespace {

void check_penetration() {
  constexpr int n = 4000;
  for (const double radius : {0.5, 1.0, 3.0}) {
    double last = -1.0;
    for (int i = 0; i <= n; ++i) {
      const double m = 4.0 / 3.0 * i / n;
      const double u = penetration(m * pi * radius * radius * radius, radius) / radius;
      CHECK_NEAR(u * u * (1.0 - u / 3.0), m, 1e-12);  // Eq. 2
      CHECK(u > last && u <= 2.0);
      last = u;
    }
    const double sphere = 4.0 / 3.0 * pi * radius * radius * radius;
    CHECK_NEAR(penetration(sphere, radius), 2.0 * radius, 1e-6);  // a double root
    CHECK_NEAR(penetration(1.1 * sphere, radius), 2.0 * radius, 0.0);
    CHECK(penetration(0.0, radius) == 0.0);
  }
  for (const double u : {1e-6, 1e-3, 0.1, 1.0, 1.5}) {
    CHECK_NEAR(penetration(pi * u * u * (1.0 - u / 3.0), 1.0) / u, 1.0, 1e-12);
  }
  CHECK_THROWS(penetration(-1.0, 3.0), "m0 must be zero or positive and finite, got -1");
  CHECK_THROWS(penetration(std::nan(""), 3.0), "m0 must be zero or positive and finite");
  CHECK_THROWS(penetration(1.0, 0.0), "radius must be positive and finite, got 0");
}

void check_force() {
  const double radius = 2.0, c_e = 1.5, u = 0.3;
  const double m0 = pi * std::pow(radius, 3) * u * u * (1.0 - u / 3.0);
  const ElasticForce elastic = elastic_force({m0, Vec3(0.0, 0.0, -0.8 * m0 * radius)}, radius, c_e);
  CHECK_NEAR(elastic.penetration, u * radius, 1e-12);
  CHECK_NEAR(elastic.force[2], c_e * radius * radius * std::pow(u, 1.5), 1e-12);  // Eq. 3
  CHECK(elastic.force[0] == 0.0 && elastic.force[1] == 0.0);
  CHECK_NEAR(elastic.normal[2], 1.0, 1e-15);
  CHECK(!elastic.ambiguous);

  const Vec3 oblique = Vec3(1.0, -2.0, 2.0) / 3.0;
  const ElasticForce other = elastic_force({m0, -0.8 * m0 * radius * oblique}, radius, c_e);
  CHECK_NEAR((other.normal - oblique).norm(), 0.0, 1e-15);
  CHECK_NEAR(other.force.norm(), elastic.force.norm(), 1e-12);
}

// From bone on one side to bone on the other, the force passes zero in proportion to m_1.
void check_fading() {
  const double radius = 2.0, c_e = 1.5, m0 = 0.5, floor = 0.1 * m0 * radius;
  const double full = elastic_force({m0, Vec3(0.0, 0.0, -2.0 * floor)}, radius, c_e).force[2];
  double last = -2.0 * full;
  for (int i = -15; i <= 15; ++i) {
    const double share = i / 10.0;
    const ElasticForce elastic = elastic_force({m0, Vec3(0.0, 0.0, -share * floor)}, radius, c_e);
    CHECK_NEAR(elastic.force[2], full * std::max(-1.0, std::min(1.0, share)), 1e-12);
    if (i != -10 && i != 10) CHECK(elastic.ambiguous == (std::abs(share) < 1.0));
    CHECK(elastic.force[2] > last - 1e-12 && elastic.force[2] - last < 1.01 * full);
    last = elastic.force[2];
  }
  CHECK(elastic_force({0.0, Vec3::Zero()}, radius, c_e).force.norm() == 0.0);
  CHECK(elastic_force({m0, Vec3::Zero()}, radius, c_e).force.norm() == 0.0);
}

}  // namespace

int main() {
  check_penetration();
  check_force();
  check_fading();
  CHECK_THROWS(elastic_force({1.0, Vec3::Zero()}, 3.0, 0.0), "c_e must be positive and finite, got 0");
  CHECK_THROWS(elastic_force({1.0, Vec3(0.0, std::nan(""), 0.0)}, 3.0, 1.0), "m1 must be finite");
  CHECK_THROWS(elastic_force({-1.0, Vec3::Zero()}, 3.0, 1.0), "m0 must be zero or positive");
  CHECK_THROWS(elastic_force({1.0, Vec3::Zero()}, -3.0, 1.0), "radius must be positive and finite, got -3");
  return check::report();
}
