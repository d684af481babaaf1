#include "depth_table.hpp"

#include <map>
#include <mutex>

#include "portable_math.hpp"
#include "require.hpp"

namespace burrlab {
namespace {

// Gauss-Legendre nodes and weights on [-1, 1], 10 points, positive half (Abramowitz and Stegun, table 25.4).
constexpr double gauss_x[5] = {0.148874338981631211, 0.433395394129247191, 0.679409568299024406,
                               0.865063366688984511, 0.973906528517171720};
constexpr double gauss_w[5] = {0.295524224714752870, 0.269266719309996355, 0.219086362515982044,
                               0.149451349150580593, 0.066671344308688138};

constexpr int panels = 26;
using Panel = std::array<double, 10>;

// Nodes of the integrals over x = e..e+1. Panels shrink towards e, where the integrand falls steeply if a is
// large.
struct Nodes {
  double inner, outer;  // x^(k+1) at e and e + 1
  std::array<Panel, panels> power, weight;

  Nodes(double e, double k) : inner(portable::pow(e, k + 1.0)), outer(portable::pow(e + 1.0, k + 1.0)) {
    double high = 1.0;
    for (int panel = 0; panel < panels; ++panel) {
      const double low = panel == panels - 1 ? 0.0 : high / 2.0;
      const double half = (high - low) / 2.0, middle = (high + low) / 2.0;
      for (std::size_t i = 0; i < 10; ++i) {
        const double side = i % 2 ? 1.0 : -1.0;
        power[panel][i] = portable::pow(e + middle + side * half * gauss_x[i / 2], k + 1.0);
        weight[panel][i] = half * gauss_w[i / 2];
      }
      high = low;
    }
  }
};

struct Integrals {
  double mass;    // int exp(-a x^(k+1)) dx
  double moment;  // int x^k exp(-a x^(k+1)) dx, closed form
  double slope;   // -d mass / da = int x^(k+1) exp(-a x^(k+1)) dx
};

Integrals integrate(double a, const Nodes& at, double k) {
  Integrals sum{0.0, 0.0, 0.0};
  for (int panel = 0; panel < panels; ++panel) {
    Panel value;
    for (std::size_t i = 0; i < 10; ++i) value[i] = -a * at.power[panel][i];
    value = portable::exp(value);
    for (std::size_t i = 0; i < 10; ++i) {
      const double weight = at.weight[panel][i] * value[i];
      sum.mass += weight;
      sum.slope += weight * at.power[panel][i];
    }
  }
  sum.moment = a * (at.outer - at.inner) < 1e-8
                   ? (at.outer - at.inner) / (k + 1.0)
                   : (portable::exp(-a * at.inner) - portable::exp(-a * at.outer)) / (a * (k + 1.0));
  return sum;
}

double effective_depth(const Nodes& at, double tau, double k) {
  if (tau >= 1.0) return portable::pow(integrate(0.0, at, k).moment, 1.0 / k);
  // mass(a) is convex and falls from 1: Newton from the left never overshoots.
  double a = 0.0;
  for (int i = 0; i < 200; ++i) {
    const Integrals now = integrate(a, at, k);
    const double step = (now.mass - tau) / now.slope;
    a += step;
    if (step <= 1e-14 * a) break;
  }
  return portable::pow(integrate(a, at, k).moment / tau, 1.0 / k);
}

}  // namespace

DepthTable::DepthTable(double k) {
  for (int i = 0; i < rows; ++i) {
    const Nodes at(i / 8.0, k);
    node_[i * columns] = static_cast<float>(i / 8.0);  // nothing left: at the outer face
    for (int j = 1; j < columns; ++j)
      node_[i * columns + j] = static_cast<float>(effective_depth(at, j / 40.0, k));
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
