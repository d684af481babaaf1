#include "burrlab/depth_table.hpp"

#include <map>
#include <mutex>

#include "burrlab/check.hpp"
#include "burrlab/portable_math.hpp"

namespace burrlab {
namespace {

// Gauss-Legendre nodes and weights on [-1, 1], 10 points, positive half (Abramowitz and Stegun, table 25.4).
constexpr double gauss_x[5] = {0.148874338981631211, 0.433395394129247191, 0.679409568299024406,
                               0.865063366688984511, 0.973906528517171720};
constexpr double gauss_w[5] = {0.295524224714752870, 0.269266719309996355, 0.219086362515982044,
                               0.149451349150580593, 0.066671344308688138};

struct Integrals {
  double mass;    // int exp(-a x^(k+1)) dx
  double moment;  // int x^k exp(-a x^(k+1)) dx, closed form
  double slope;   // -d mass / da = int x^(k+1) exp(-a x^(k+1)) dx
};

// Over x = e..e+1. Panels shrink towards e, where the integrand falls steeply if a is large.
Integrals integrate(double a, double e, double k) {
  Integrals sum{0.0, 0.0, 0.0};
  double high = 1.0;
  for (int panel = 0; panel < 26; ++panel) {
    const double low = panel == 25 ? 0.0 : high / 2.0;
    const double half = (high - low) / 2.0, middle = (high + low) / 2.0;
    for (int i = 0; i < 5; ++i) {
      for (const double side : {-1.0, 1.0}) {
        const double x = e + middle + side * half * gauss_x[i];
        const double power = portable::pow(x, k + 1.0);
        const double weight = half * gauss_w[i] * portable::exp(-a * power);
        sum.mass += weight;
        sum.slope += weight * power;
      }
    }
    high = low;
  }
  const double inner = portable::pow(e, k + 1.0), outer = portable::pow(e + 1.0, k + 1.0);
  sum.moment = a * (outer - inner) < 1e-8
                   ? (outer - inner) / (k + 1.0)
                   : (portable::exp(-a * inner) - portable::exp(-a * outer)) / (a * (k + 1.0));
  return sum;
}

double effective_depth(double e, double tau, double k) {
  if (tau <= 0.0) return e;
  if (tau >= 1.0) return portable::pow(integrate(0.0, e, k).moment, 1.0 / k);
  // mass(a) is convex and falls from 1: Newton from the left never overshoots.
  double a = 0.0;
  for (int i = 0; i < 200; ++i) {
    const Integrals now = integrate(a, e, k);
    const double step = (now.mass - tau) / now.slope;
    a += step;
    if (step <= 1e-14 * a) break;
  }
  return portable::pow(integrate(a, e, k).moment / tau, 1.0 / k);
}

}  // namespace

DepthTable::DepthTable(double k) {
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < columns; ++j) {
      node_[i * columns + j] = static_cast<float>(effective_depth(i / 8.0, j / 40.0, k));
    }
  }
  float* cell = cell_.data();
  for (int i = 0; i < rows - 1; ++i) {
    for (int j = 0; j < columns - 1; ++j) {
      for (const float* node : {&node_[i * columns + j], &node_[(i + 1) * columns + j]}) {
        *cell++ = node[0];
        *cell++ = node[1] - node[0];
      }
    }
  }
}

std::shared_ptr<const DepthTable> DepthTable::of_order(double k) {
  if (!(k > 0.0 && k <= 8.0)) refuse("order", "in (0, 8]", k);
  static std::mutex mutex;
  static std::map<double, std::shared_ptr<const DepthTable>> tables;
  const std::lock_guard<std::mutex> lock(mutex);
  auto& table = tables[k];
  if (!table) table.reset(new DepthTable(k));
  return table;
}

}  // namespace burrlab
