// Contact stiffness, closed form against voxels; the limits; the force at the limit.
#include "session/contact_stiffness.hpp"

#include <complex>

#include "check.hpp"
#include "session_scenes.hpp"

using namespace burrlab;

namespace {

/// Wetted area on flat bone, projected on the normal [mm^2]: the cap's, of depth h; the same in the burr's
/// own hole of depth H.
double cap_area(double radius, double depth) { return pi * (2.0 * radius * depth - depth * depth); }

/// k = dF/dH [N/mm] at a force [N] and a wetted area [mm^2].
double contact_stiffness(double force, double area, double radius, double c_e, double q = 1.5) {
  const double u = std::pow(force / (c_e * radius * radius), 1.0 / q);
  return q * c_e * std::pow(u, q - 1.0) * area / (pi * radius * (2.0 * u - u * u));
}

/// Voxels against the closed form, on flat bone and in a hole of R/3.
void check_stiffness(const Material& material, double force, double hole, double tolerance) {
  const auto executor = scenes::executor(scenes::block_with_hole(3.0, hole), material);
  const double top = 3.0 - hole, depth = scenes::depth_of(executor, force, top);
  const Vec3 center(0.0, 0.0, top - depth);
  const double penetration = executor.probe(0, center).penetration;
  const double area = cap_area(3.0, hole > 0.0 ? hole + depth : penetration);
  const double q = material.force_exponent;
  const double closed = contact_stiffness(force, area, 3.0, material.c_e, q);
  const double measured = measured_stiffness(executor, 0, center);
  std::printf("%s, q = %g, %.1f N, hole %.1f mm: k %.4g N/mm in closed form, %.4g measured (%+.1f %%)\n",
              material.name.c_str(), q, force, hole, closed, measured, 100.0 * (measured / closed - 1.0));
  CHECK_NEAR(measured / closed, 1.0, tolerance);
  CHECK_NEAR(contact_area(force, closed, 3.0, material.c_e, q), area, 1e-9 * area);
}

void check_against_voxels() {
  for (const double force : {0.3, 1.0, 2.0}) {
    check_stiffness(scenes::bone_material, force, 0.0, 0.01);
    // At 0.3 N the burr is 0.02 mm deep in its hole, a fifth of a voxel.
    check_stiffness(scenes::bone_material, force, 1.0, force < 0.5 ? 0.12 : 0.02);
  }
  for (const double q : {1.0, 2.0, 2.5}) {
    Material material = scenes::bone_material;
    material.force_exponent = q;
    check_stiffness(material, 1.0, 0.0, 0.01);
    check_stiffness(material, 3.0, 1.0, 0.02);
  }
  check_stiffness(scenes::pvc, 0.1, 0.0, 0.01);
  check_stiffness(scenes::pvc, 0.3, 1.0, 0.04);
  const auto executor = scenes::executor(scenes::block(), scenes::bone_material);
  CHECK(measured_stiffness(executor, 0, Vec3(0.0, 0.0, 3.2)) == 0.0);
}

/// On flat bone and in a shallow hole the normal is the stiffest direction; in a narrow tunnel, sideways is.
void check_stiffest() {
  for (const double hole : {0.0, 1.0, 2.8}) {
    const auto executor = scenes::executor(scenes::block_with_hole(3.0, hole), scenes::bone_material);
    const Vec3 center(0.0, 0.0, 3.0 - hole - scenes::depth_of(executor, 2.0, 3.0 - hole));
    const double stiffest = stiffest_contact(executor, 0, center);
    const double normal = measured_stiffness(executor, 0, center);
    std::printf("hole %.1f mm: normal %.2f N/mm, stiffest %.2f\n", hole, normal, stiffest);
    if (hole < 2.0)
      CHECK_NEAR(stiffest, normal, 1e-3 * normal);
    else
      CHECK(stiffest > 1.05 * normal);
  }
  const auto executor = scenes::executor(scenes::block(), scenes::bone_material);
  CHECK(stiffest_contact(executor, 0, Vec3(0.0, 0.0, 3.2)) == 0.0);
}

/// On flat bone the closed form is dF/dh of Eq. 3; in a hole k is far above dF/dh.
void check_closed_form() {
  const double c_e = 2.145, radius = 3.0, force = 1.0;
  const double u = std::pow(force / (c_e * radius * radius), 2.0 / 3.0);
  const double by_depth = 1.5 * c_e * radius * std::sqrt(u);  // dF/dh
  CHECK_NEAR(contact_stiffness(force, cap_area(radius, u * radius), radius, c_e), by_depth, 1e-12);
  CHECK(contact_stiffness(force, cap_area(radius, 1.0), radius, c_e) > 2.0 * by_depth);
}

void check_limits() {
  CHECK_NEAR(passivity_limit(5.0, 1.0), 10.0, 1e-14);  // 5 N s/m over 0.5 ms: 10 N/mm
  CHECK_NEAR(passivity_limit(5.0, 1.0, 2.0), 2.0, 1e-14);
  CHECK_NEAR(passivity_limit(5.0, 0.1), 100.0, 1e-12);
  CHECK_NEAR(encoder_limit(0.04, 0.03), 8.0 / 3.0, 1e-14);
  CHECK(std::isinf(encoder_limit(0.0, 0.0)) && encoder_limit(0.0, 0.03) == 0.0);
}

/// Colgate and Schenkel: b > T/2/(1 - cos wT) Re{(1 - e^-jwT) H(e^jwT)} at every w up to the Nyquist
/// frequency. For H = K z^-delay this is exactly our limit.
void check_general_condition() {
  const double period = 1e-3, k = 3000.0;  // [s], [N/m]
  for (const int delay : {0, 1, 3}) {
    double needed = 0.0;
    for (double w = 1e-3; w < pi; w += 1e-4) {
      const std::complex<double> back = std::polar(1.0, -w);  // z^-1
      const double real = ((1.0 - back) * k * std::pow(back, delay)).real();
      needed = std::max(needed, 0.5 * period / (1.0 - std::cos(w)) * real);
    }
    const double b = k * (0.5 + delay) * period;
    CHECK_NEAR(needed, b, 1e-4 * b);
    CHECK_NEAR(1e3 * passivity_limit(b, 1e3 * period, 1e3 * delay * period), k, 1e-9 * k);
  }
}

void check_force_at_limit() {
  const double c_e = 2.145, radius = 3.0;
  for (const double area : {2.0, 8.0, pi * 5.0})
    for (const double force : {0.05, 0.3, 1.0, 2.0}) {
      const double k = contact_stiffness(force, area, radius, c_e);
      CHECK_NEAR(force_at_limit(k, area, radius, c_e), force, 1e-9);
    }
  for (const double q : {1.0, 1.25, 1.75, 2.0, 3.0})
    for (const double force : {0.05, 1.0, 2.0})
      CHECK_NEAR(force_at_limit(contact_stiffness(force, 8.0, radius, c_e, q), 8.0, radius, c_e, q), force,
                 1e-9);
  const double at_limit =
      force_at_limit(3.0, 5.0, radius, c_e);  // the closed form, and its neighbours by halving
  for (const double q : {1.5 - 1e-9, 1.5 + 1e-9})
    CHECK_NEAR(force_at_limit(3.0, 5.0, radius, c_e, q), at_limit, 1e-7);
  CHECK(std::isinf(force_at_limit(1.0, pi * 5.0, radius, c_e)));  // stiffer at any force
  CHECK(std::isinf(force_at_limit(1.0, pi * 5.0, radius, c_e, 1.0)));
  CHECK(force_at_limit(1.0, pi * 9.0, radius, c_e, 2.0) == 0.0);  // stiffer above 0 N
  CHECK(std::isinf(force_at_limit(3.0, 0.0, radius, c_e, 2.0)));  // at no force
  CHECK(force_at_limit(3.0, 0.0, radius, c_e) == 0.0);
}

void check_report() {
  Tool tool{Burr(3.0), scenes::bone_material};
  DeviceModel device;
  StabilityReport report = stability_report(1.0, 7.0, tool, device, 1.0);
  CHECK(std::isnan(report.limit) && std::isnan(report.ratio) && std::isnan(report.force_at_limit));
  CHECK(!report.warning && report.k == 7.0);

  device.damping = 5.0;
  report = stability_report(1.0, 7.0, tool, device, 1.0);
  CHECK_NEAR(report.ratio, 0.7, 1e-12);
  CHECK(!report.warning && report.limit == report.sampling_limit);
  const double at = report.force_at_limit;
  CHECK(at > 0.0 && at < 1.0);
  CHECK_NEAR(contact_stiffness(at, report.area, 3.0, 2.145), 10.0, 1e-9);
  CHECK(stability_report(1.0, 8.1, tool, device, 1.0).warning);

  device.encoder_step = 0.03;
  device.friction = 0.04;
  report = stability_report(1.0, 7.0, tool, device, 1.0);
  CHECK_NEAR(report.limit, 8.0 / 3.0, 1e-12);
  CHECK(report.warning && report.force_at_limit > 1.0);

  // With a coupling of 2 N/mm no contact is stiffer; one of 4 leaves 8 N/mm to the contact.
  CHECK(stability_report(1.0, 7.0, tool, device, 1.0, 0.0, 2.0).force_at_limit == 0.0);
  report = stability_report(1.0, 7.0, tool, device, 1.0, 0.0, 4.0);
  CHECK_NEAR(report.k, 28.0 / 11.0, 1e-12);
  CHECK_NEAR(contact_stiffness(report.force_at_limit, report.area, 3.0, 2.145), 8.0, 1e-9);

  tool.material.force_exponent = 2.0;  // stiffer than 8 N/mm above a force that is beyond 1 N
  report = stability_report(1.0, 7.0, tool, device, 1.0, 0.0, 4.0);
  CHECK(report.stiffer_above && report.force_at_limit > 1.0);
  CHECK_NEAR(contact_stiffness(report.force_at_limit, report.area, 3.0, 2.145, 2.0), 8.0, 1e-9);
  CHECK(std::isinf(stability_report(1.0, 7.0, tool, device, 1.0, 0.0, 2.0).force_at_limit));
}

void check_refusals() {
  const Tool tool{Burr(3.0), scenes::bone_material};
  CHECK_THROWS(contact_area(1.0, -1.0, 3.0, 2.0), "stiffness must be zero or positive");
  CHECK_THROWS(contact_area(-1.0, 1.0, 3.0, 2.0), "force must be zero or positive");
  CHECK_THROWS(contact_area(1.0, 1.0, 3.0, 0.0), "c_e must be positive");
  CHECK_THROWS(contact_area(1.0, 1.0, 0.0, 2.0), "radius must be positive");
  CHECK_THROWS(stability_report(1.0, 1.0, tool, {-1.0}, 1.0), "damping must be zero or positive");
  CHECK_THROWS(stability_report(1.0, 1.0, tool, {1.0, -1.0, 0.0}, 1.0),
               "encoder_step must be zero or positive");
  CHECK_THROWS(stability_report(1.0, 1.0, tool, {1.0, 1.0, -1.0}, 1.0), "friction must be zero or positive");
  CHECK_THROWS(stability_report(1.0, 1.0, tool, {1.0}, 0.0), "period must be positive");
  CHECK_THROWS(stability_report(1.0, 1.0, tool, {1.0}, 1.0, 0.0, 0.0), "coupling must be positive, got 0");
  CHECK_THROWS(passivity_limit(1.0, 1.0, -1.0), "age must be zero or positive");
  CHECK_THROWS(force_at_limit(-1.0, 1.0, 1.0, 1.0), "limit must be zero or positive");
}

}  // namespace

int main() {
  check_against_voxels();
  check_stiffest();
  check_closed_form();
  check_limits();
  check_general_condition();
  check_force_at_limit();
  check_report();
  check_refusals();
  return check::report();
}
