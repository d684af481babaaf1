// Method. A slice is the bone that the burr's front meets at one immersion s, a copy of the front's surface
// at depth s. A place in it is named by p, the cosine of the front's slope: 1 on the axis, 1 - s at the rim.
// At height y = H - s above the front, 1 - x^2 = y (2 p - y). The slowness dt/dH is constant in each step, so
// -log(density) is a sum of slowness * (int f dH); the slowness of each step leaves the mass of Eq. 2 in the
// burr. Slices are sampled at their middle: second order.
#include "burrlab/mean_field.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "require.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {
namespace {

constexpr std::size_t node_count = 4;
using AtNodes = std::array<double, node_count>;
// Gauss-Legendre on [0, 1], for the integral over p.
constexpr AtNodes node{0.06943184420297371, 0.33000947820757187, 0.66999052179242813, 0.93056815579702629};
constexpr AtNodes weight{0.17392742256872693, 0.32607257743127307, 0.32607257743127307, 0.17392742256872693};

constexpr double tolerance = 1e-12;   // of the mass
constexpr double gone = 28.0;         // densities below exp(-28) = 7e-13 are dropped
constexpr double step_limit = 200e3;  // seconds of work

/// Volume/pi of a unit sphere's cap of height u: m of Eq. 2, and m(H) of all the front has passed.
double cap(double u) { return u * u * (1.0 - u / 3.0); }

struct Slice {
  double s;          // immersion at which the front meets it
  AtNodes p;         // cosine of the front's slope
  AtNodes volume;    // /pi, belonging to each p
  AtNodes exponent;  // -log(density)
  AtNodes dose;      // int f dH over the present step

  Slice(double begin, double end) : s(0.5 * (begin + end)), exponent{}, dose{} {
    const double unit = (cap(end) - cap(begin)) / (1.0 - 0.5 * s);  // over int p dp / s
    for (std::size_t j = 0; j < node_count; ++j) {
      p[j] = 1.0 - s * node[j];
      volume[j] = unit * weight[j] * p[j];
    }
  }

  /// For a height above the front from y0 to y1. The factor y^k of f is integrated exactly, the smooth rest
  /// by the midpoint rule.
  void set_dose(const Shape& shape, double y0, double y1) {
    const double k = shape.order(), y = 0.5 * (y0 + y1);
    double length = y1 - y0;
    if (k != 0.0 && k != 1.0)
      length = y * (std::pow(y1 / y, k + 1.0) - std::pow(y0 / y, k + 1.0)) / (k + 1.0);
    for (std::size_t j = 0; j < node_count; ++j) {
      const double w = y * (2.0 * p[j] - y);  // 1 - x^2
      dose[j] = length * shape.at_depth(w / (1.0 + std::sqrt(std::max(0.0, 1.0 - w))));
    }
  }
};

class Layer {
 public:
  Layer(const Shape& shape, double contact, int slices) : shape_(shape), mass_(cap(contact)) {
    for (int i = 0; i < slices; ++i) slices_.emplace_back(contact * i / slices, contact * (i + 1) / slices);
  }

  /// Moves the front. Returns the slowness [1/(alpha R)] that keeps the mass; `guess` starts the search.
  double advance(double from, double to, double guess) {
    slices_.emplace_back(from, to);
    for (std::size_t i = first_; i < slices_.size(); ++i)
      slices_[i].set_dose(shape_, std::max(0.0, from - slices_[i].s), to - slices_[i].s);
    const double slowness = solve(guess);
    for (std::size_t i = first_; i < slices_.size(); ++i)
      for (std::size_t j = 0; j < node_count; ++j) slices_[i].exponent[j] += slowness * slices_[i].dose[j];
    while (first_ + 1 < slices_.size() && is_gone(slices_[first_])) ++first_;
    return slowness;
  }

 private:
  static bool is_gone(const Slice& slice) {
    return *std::min_element(slice.exponent.begin(), slice.exponent.end()) > gone;
  }

  // Newton's method. The mass is a convex, falling function of the slowness. Only the first step can pass the
  // root, to the side from which no further step does. A step leaves at most half of the curvature times its
  // square, or little more; where that is surely below the tolerance, the mass need not be summed once more.
  double solve(double slowness) const {
    for (int iteration = 0; iteration < 100; ++iteration) {
      double mass = 0.0, loss = 0.0, curvature = 0.0;
      for (std::size_t i = first_; i < slices_.size(); ++i) {
        const Slice& slice = slices_[i];
        for (std::size_t j = 0; j < node_count; ++j) {
          const double part = slice.volume[j] * std::exp(-slice.exponent[j] - slowness * slice.dose[j]);
          const double lost = part * slice.dose[j];
          mass += part;
          loss += lost;
          curvature += lost * slice.dose[j];
        }
      }
      if (std::abs(mass - mass_) < tolerance * mass_) break;
      const double step = (mass - mass_) / loss;
      slowness = std::max(0.0, slowness + step);
      if (slowness > 0.0 && curvature * step * step < 0.5 * tolerance * mass_) break;
    }
    return slowness;
  }

  Shape shape_;
  double mass_;
  std::vector<Slice> slices_;
  std::size_t first_ = 0;  // older slices are dropped
};

// The step at the stop is a fraction of the layer's mean thickness m/area there. Steps are equal in H^2, as
// the layer thins as 1/H.
double count_steps(const Shape& shape, double contact, double stop, double resolution) {
  const double k = shape.order(), v = thin_layer_velocity(shape, contact * std::sqrt(contact), stop);
  const double thickness =
      std::tgamma((k + 2.0) / (k + 1.0)) * std::pow((k + 1.0) * v / shape.kappa(), 1.0 / (k + 1.0));
  const double step = thickness / (8.0 + 2.0 * k);
  return std::ceil(resolution *
                   std::max(64.0 + 8.0 * k, (stop - contact) * (stop + contact) / (2.0 * stop * step)));
}

// The time at which a rising immersion reaches `level`, which must be in its range.
double time_at(const std::vector<double>& time, const std::vector<double>& immersion, double level) {
  const auto above = std::upper_bound(immersion.begin() + 1, immersion.end() - 1, level);
  const std::size_t i = static_cast<std::size_t>(above - immersion.begin());
  const double part = (level - immersion[i - 1]) / (immersion[i] - immersion[i - 1]);
  return time[i - 1] + part * (time[i] - time[i - 1]);
}

}  // namespace

MeanFieldDescent mean_field_descent(const Shape& shape, double phi, double stop, double resolution) {
  const StandardEnvironment environment;
  require_positive("phi", phi);
  require_positive("resolution", resolution);
  if (resolution > 64.0) refuse("resolution", "at most 64", resolution);  // a descent then takes seconds
  if (!(stop > 0.0 && stop <= 1.0)) refuse("stop", "in (0, 1]", stop);
  // Eq. 3: u = phi^(2/3), and H = u on untouched bone. The descent knows the force by u alone, so that of a
  // force exponent q is this one at phi = (F/(c_e R^2))^(3/(2q)), and a rate exponent m only makes alpha
  // alpha (F/1 N)^m.
  const double contact = std::cbrt(phi * phi);
  if (!(contact < stop)) refuse("phi", "below stop^1.5, or static contact alone reaches the stop,", phi);
  const double steps = count_steps(shape, contact, stop, resolution);
  if (!(steps <= step_limit))
    refuse("steps of the descent", "at most 200000 (raise phi or lower the resolution)", steps);
  Layer layer(shape, contact, static_cast<int>(std::ceil((48.0 + 8.0 * shape.order()) * resolution)));
  MeanFieldDescent descent{{0.0}, {contact}};
  double slowness = 0.0, previous = 0.0;
  for (double n = 1.0; n <= steps; ++n) {
    const double from = descent.immersion.back();
    const double to =
        n < steps ? std::sqrt(contact * contact + (stop * stop - contact * contact) * n / steps) : stop;
    const double guess = n > 2.0 ? 2.0 * slowness - previous : slowness;
    previous = slowness;
    slowness = layer.advance(from, to, guess);
    descent.time.push_back(descent.time.back() + slowness * (to - from));
    descent.immersion.push_back(to);
  }
  return descent;
}

// A column where the front's slope has cosine p holds rho = exp(-kappa p^k y^(k+1)/((k+1) v)), hence the mass
// Gamma(q) ((k+1) v/(kappa p^k))^(1/(k+1)) per area, q = (k+2)/(k+1). Over the immersed cap, area 2 pi p dp,
// this must be the mass of Eq. 2.
double thin_layer_velocity(const Shape& shape, double phi, double immersion) {
  const StandardEnvironment environment;
  require_positive("phi", phi);
  if (!(immersion > 0.0 && immersion <= 1.0)) refuse("immersion", "in (0, 1]", immersion);
  const double k = shape.order(), q = (k + 2.0) / (k + 1.0);
  const double area = -2.0 * std::expm1(q * std::log1p(-immersion)) / q;  // int 2 p^(1/(k+1)) dp
  const double thickness = cap(std::cbrt(phi * phi)) / area;
  return shape.kappa() / (k + 1.0) * std::pow(thickness / std::tgamma(q), k + 1.0);
}

double window_velocity(const std::vector<double>& time, const std::vector<double>& immersion, double start,
                       double stop) {
  const StandardEnvironment environment;
  if (time.size() != immersion.size() || time.size() < 2)
    throw InvalidArgument("time and immersion must have the same length, two points or more");
  for (std::size_t i = 0; i < time.size(); ++i) {
    require_finite("every time", time[i]);
    require_finite("every immersion", immersion[i]);
    if (i > 0 && !(time[i] > time[i - 1])) refuse("time", "rising", time[i]);
    if (i > 0 && !(immersion[i] > immersion[i - 1])) refuse("immersion", "rising", immersion[i]);
  }
  if (!(start >= immersion.front())) refuse("start", "within the immersions given", start);
  if (!(stop <= immersion.back())) refuse("stop", "within the immersions given", stop);
  if (!(start < stop)) refuse("start", "below stop", start);

  const double t_start = time_at(time, immersion, start), t_stop = time_at(time, immersion, stop);
  const double span = t_stop - t_start, middle = 0.5 * (t_start + t_stop);
  double covariance = 0.0;  // int (t - middle) (H - start) dt
  double ta = t_start - middle, ha = 0.0;
  const auto add = [&](double tb, double hb) {
    covariance += (tb - ta) * (2.0 * (ta * ha + tb * hb) + ta * hb + tb * ha) / 6.0;
    ta = tb;
    ha = hb;
  };
  for (std::size_t i = 0; i < time.size(); ++i)
    if (immersion[i] > start && immersion[i] < stop) add(time[i] - middle, immersion[i] - start);
  add(t_stop - middle, stop - start);
  return 12.0 * covariance / (span * span * span);  // int (t - middle)^2 dt = span^3/12
}

}  // namespace burrlab
