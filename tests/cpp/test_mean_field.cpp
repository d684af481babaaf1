// The mean-field descent: values, closed forms, and the order of convergence.
#include "burrlab/mean_field.hpp"

#include <algorithm>
#include <limits>

#include "check.hpp"

using namespace burrlab;

namespace {

constexpr double third = 1.0 / 3.0;
constexpr double nan = std::numeric_limits<double>::quiet_NaN();

// Over the default window max(R/6, static immersion) .. R/3.
double velocity(const Shape& shape, double phi, double resolution = 1.0) {
  const MeanFieldDescent descent = mean_field_descent(shape, phi, third, resolution);
  return window_velocity(descent.time, descent.immersion, std::max(third / 2.0, descent.immersion.front()),
                         third);
}

void test_values() {
  CHECK_NEAR(velocity(Shape::parabolic(), 0.025), 2.74e-4, 0.01 * 2.74e-4);
  CHECK_NEAR(velocity(Shape::parabolic(), 0.05), 1.736e-3, 0.01 * 1.736e-3);
  CHECK_NEAR(velocity(Shape::parabolic(), 0.1), 9.96e-3, 0.01 * 9.96e-3);
}

// For f = 1 the mass erodes at its own rate: dH/dt = m/(2 H - H^2), so t = (H^2 - H^3/3 - m)/m.
void test_constant_is_exact() {
  const double m = std::pow(0.05, 4.0 / 3.0) * (1.0 - std::pow(0.05, 2.0 / 3.0) / 3.0);
  CHECK_NEAR(thin_layer_velocity(Shape::parse("constant"), 0.05, 0.3), m / (0.6 - 0.09), 1e-14);
  for (double resolution : {1.0, 4.0}) {
    const MeanFieldDescent descent = mean_field_descent(Shape::parse("constant"), 0.05, third, resolution);
    const double exact = (third * third * (1.0 - third / 3.0) - m) / m;
    CHECK_NEAR(descent.time.back(), exact, 1e-3 / (resolution * resolution) * exact);
  }
}

void test_thin_layer_law() {
  const double u2 = std::pow(0.03, 4.0 / 3.0), u = std::sqrt(u2), pi = 3.14159265358979323846;
  const double root = 3.0 * u2 * (1.0 - u / 3.0) / (2.0 * (1.0 - std::pow(0.8, 1.5)));
  CHECK_NEAR(thin_layer_velocity(Shape::parabolic(), 0.03, 0.2) / (root * root / pi), 1.0, 1e-12);
  CHECK_NEAR(thin_layer_velocity(Shape::parse("linear"), 0.03, 0.2) / (root * root / (2.0 * pi)), 1.0, 1e-12);
  for (const char* name : {"parabolic", "linear", "quartic", "power(0.5)", "power(4)"}) {
    const Shape shape = Shape::parse(name);  // the slope at one immersion, against the law
    const MeanFieldDescent descent = mean_field_descent(shape, 0.003, third);
    const double v = window_velocity(descent.time, descent.immersion, 0.249, 0.251);
    CHECK_NEAR(v / thin_layer_velocity(shape, 0.003, 0.25), 1.0, 0.01);
  }
}

void test_convergence() {
  for (const char* name : {"parabolic", "linear", "quartic", "power(0.3)", "power(1.5)", "power(8)"}) {
    for (double phi : {0.05, 0.1, 0.17}) {
      const Shape shape = Shape::parse(name);
      const double v1 = velocity(shape, phi, 1.0), v2 = velocity(shape, phi, 2.0),
                   v4 = velocity(shape, phi, 4.0);
      const double limit = v4 + (v4 - v2) / 3.0, e1 = v1 / limit - 1.0, e4 = v4 / limit - 1.0;
      CHECK(std::abs(e1) < 1e-3);
      CHECK(std::abs(e4) < std::max(std::abs(e1) / 8.0, 1e-5));  // order 2 gives 16
    }
  }
}

void test_trajectory() {
  const MeanFieldDescent descent = mean_field_descent(Shape::parabolic(), 0.1, third);
  CHECK(descent.time.size() == descent.immersion.size());
  CHECK(descent.time.front() == 0.0);
  CHECK_NEAR(descent.immersion.front(), std::pow(0.1, 2.0 / 3.0), 1e-15);
  CHECK(descent.immersion.back() == third);
  CHECK(std::is_sorted(descent.time.begin(), descent.time.end()));
  CHECK(mean_field_descent(Shape::parse("linear"), 0.999, 1.0).immersion.back() == 1.0);
}

void test_window_velocity() {
  CHECK_NEAR(window_velocity({0.0, 1.0, 4.0}, {0.0, 2.0, 8.0}, 1.0, 7.0), 2.0, 1e-15);
  // H = t on 0..1, 3 t - 2 on 1..2: 12 int (t - 1) H dt / 2^3 = 2
  CHECK_NEAR(window_velocity({0.0, 1.0, 2.0}, {0.0, 1.0, 4.0}, 0.0, 4.0), 2.0, 1e-15);
}

void test_errors() {
  const Shape f = Shape::parabolic();
  CHECK_THROWS(mean_field_descent(f, 0.0, third), "phi must be positive");
  CHECK_THROWS(mean_field_descent(f, nan, third), "phi must be positive");
  CHECK_THROWS(mean_field_descent(f, 0.2, third), "phi must be below stop^1.5");
  CHECK_THROWS(mean_field_descent(f, 0.1, 1.1), "stop must be in (0, 1]");
  CHECK_THROWS(mean_field_descent(f, 0.1, nan), "stop must be in (0, 1]");
  CHECK_THROWS(mean_field_descent(f, 0.1, third, 0.0), "resolution must be positive");
  CHECK_THROWS(mean_field_descent(f, 1e-6, third), "steps of the descent must be at most 200000");
  CHECK_THROWS(thin_layer_velocity(f, -1.0, 0.2), "phi must be positive");
  CHECK_THROWS(thin_layer_velocity(f, 0.1, 0.0), "immersion must be in (0, 1]");
  CHECK_THROWS(window_velocity({0.0}, {0.0}, 0.0, 1.0), "two points or more");
  CHECK_THROWS(window_velocity({0.0, 1.0}, {0.0, nan}, 0.0, 1.0), "every immersion must be finite");
  CHECK_THROWS(window_velocity({0.0, 0.0}, {0.0, 1.0}, 0.0, 1.0), "time must be rising");
  CHECK_THROWS(window_velocity({0.0, 1.0}, {1.0, 0.0}, 0.0, 1.0), "immersion must be rising");
  CHECK_THROWS(window_velocity({0.0, 1.0}, {0.0, 1.0}, -0.1, 1.0), "start must be within");
  CHECK_THROWS(window_velocity({0.0, 1.0}, {0.0, 1.0}, 0.0, 1.1), "stop must be within");
  CHECK_THROWS(window_velocity({0.0, 1.0}, {0.0, 1.0}, 0.5, 0.5), "start must be below stop");
}

}  // namespace

int main() {
  test_values();
  test_constant_is_exact();
  test_thin_layer_law();
  test_convergence();
  test_trajectory();
  test_window_velocity();
  test_errors();
  return check::report();
}
