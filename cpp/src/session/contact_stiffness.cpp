#include "session/contact_stiffness.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "require.hpp"

namespace burrlab {

/// u^(2-q) (2 - u); k times this is q c_e A/(pi R).
static double softness(double u, double q) {
  return (q == Material::paper_force_exponent ? std::sqrt(u) : std::pow(u, 2.0 - q)) * (2.0 - u);
}

double contact_area(double force, double stiffness, double radius, double c_e, double force_exponent) {
  require_not_negative("stiffness", stiffness);
  require_positive("radius", radius);
  require_positive("c_e", c_e);
  require_not_negative("force", force);
  if (stiffness == 0.0) return 0.0;  // also where u = 0 and q > 2
  const double u = std::min(std::pow(force / (c_e * radius * radius), 1.0 / force_exponent), 2.0);  // Eq. 3
  return stiffness * softness(u, force_exponent) * pi * radius / (force_exponent * c_e);
}

double measured_stiffness(const TickExecutor& executor, std::size_t burr, const Vec3& center, double step) {
  require_positive("step", step);
  const Contact contact = executor.probe(burr, center);
  const double length = contact.normal.norm();
  if (!(contact.touching && length > 0.0)) return 0.0;
  const Vec3 normal = contact.normal / length;
  const Vec3 in = executor.probe(burr, center - step * normal).force;
  const Vec3 out = executor.probe(burr, center + step * normal).force;
  return (in - out).dot(normal) / (2.0 * step);
}

double stiffest_contact(const TickExecutor& executor, std::size_t burr, const Vec3& center, double step) {
  require_positive("step", step);
  if (!executor.probe(burr, center).touching) return 0.0;
  Eigen::Matrix3d stiffness;
  for (int axis = 0; axis < 3; ++axis) {
    const Vec3 way = step * Vec3::Unit(axis);
    stiffness.col(axis) =
        (executor.probe(burr, center - way).force - executor.probe(burr, center + way).force) / (2.0 * step);
  }
  const Eigen::Matrix3d symmetric = 0.5 * (stiffness + stiffness.transpose());
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(symmetric).eigenvalues()[2];
}

double passivity_limit(double damping, double period, double age) {
  require_not_negative("damping", damping);
  require_positive("period", period);
  require_not_negative("age", age);
  return damping / (0.5 * period + age);  // N s/m over ms is N/mm
}

double encoder_limit(double friction, double encoder_step) {
  require_not_negative("friction", friction);
  require_not_negative("encoder_step", encoder_step);
  return encoder_step > 0.0 ? 2.0 * friction / encoder_step : std::numeric_limits<double>::infinity();
}

// u^(2-q) (2 - u) = b, b = q c_e A/(pi R limit). For q = 3/2 and w = sqrt(u) this is w^3 - 2 w + b = 0;
// w = a sin t, a^2 = 8/3, turns it into (2 a/3) sin 3 t = b. Else by halving, where the left side rises up to
// its maximum (q < 2) or falls from u = 0 on.
double force_at_limit(double limit, double area, double radius, double c_e, double force_exponent) {
  require_not_negative("area", area);
  require_positive("radius", radius);
  require_positive("c_e", c_e);
  require_not_negative("limit", limit);
  const double q = force_exponent, infinity = std::numeric_limits<double>::infinity();
  if (area == 0.0) return q < 2.0 ? 0.0 : infinity;
  const double b = q * c_e * area / (pi * radius * limit);
  if (q != Material::paper_force_exponent) {
    double low = 0.0, high = q < 2.0 ? 2.0 * (2.0 - q) / (3.0 - q) : 2.0;
    if (q < 2.0 && !(softness(high, q) >= b)) return infinity;
    for (int i = 0; i < 100; ++i) {
      const double u = 0.5 * (low + high);
      ((softness(u, q) < b) == (q < 2.0) ? low : high) = u;
    }
    return c_e * radius * radius * std::pow(low, q);
  }
  const double a = std::sqrt(8.0 / 3.0);
  const double sine = 1.5 * b / a;
  if (!(sine <= 1.0)) return infinity;
  const double w = a * std::sin(std::asin(sine) / 3.0);
  return c_e * radius * radius * w * w * w;  // Eq. 3
}

StabilityReport stability_report(double force, double k, const Tool& tool, const DeviceModel& device,
                                 double period, double age, double coupling) {
  const double radius = tool.burr.radius, c_e = tool.material.c_e, q = tool.material.force_exponent;
  if (!(coupling > 0.0)) refuse("coupling", "positive", coupling);
  StabilityReport report;
  report.force = force;
  report.delay = 0.5 * period + age;
  report.area = contact_area(force, k, radius, c_e, q);
  report.stiffer_above = q >= 2.0;
  report.k = std::isinf(coupling) ? k : k * coupling / (k + coupling);
  if (!std::isnan(device.damping)) report.sampling_limit = passivity_limit(device.damping, period, age);
  if (!std::isnan(device.encoder_step) && (device.encoder_step == 0.0 || !std::isnan(device.friction)))
    report.quantisation_limit =
        encoder_limit(device.encoder_step == 0.0 ? 0.0 : device.friction, device.encoder_step);
  report.limit = std::fmin(report.sampling_limit, report.quantisation_limit);  // NaN only if both are
  if (std::isnan(report.limit)) return report;
  report.ratio = report.k / report.limit;
  report.warning = report.ratio > StabilityReport::warning_ratio;
  // A coupling below the limit keeps any contact passive; above it, the contact alone may be this stiff.
  const bool passive = coupling <= report.limit;
  const double alone =
      passive || std::isinf(coupling) ? report.limit : 1.0 / (1.0 / report.limit - 1.0 / coupling);
  report.force_at_limit = burrlab::force_at_limit(alone, passive ? 0.0 : report.area, radius, c_e, q);
  return report;
}

}  // namespace burrlab
