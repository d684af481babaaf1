#include "burrlab/mean_field.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "burrlab/check.hpp"

namespace burrlab {
namespace {

// Gauss-Legendre nodes and weights on [0, 1], over the area of a slice.
#ifndef NODES
#define NODES 6
#endif
constexpr int nodes = NODES;
#if NODES == 4
constexpr std::array<double, nodes> node{0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970263};
constexpr std::array<double, nodes> weight{0.17392742256872693, 0.32607257743127307, 0.32607257743127307, 0.17392742256872693};
#elif NODES == 6
constexpr std::array<double, nodes> node{0.033765242898423986, 0.16939530676686774, 0.38069040695840155,
                                         0.61930959304159845,  0.83060469323313226, 0.96623475710157601};
constexpr std::array<double, nodes> weight{0.085662246189585173, 0.18038078652406930, 0.23395696728634552,
                                           0.23395696728634552,  0.18038078652406930, 0.085662246189585173};
#else
constexpr std::array<double, nodes> node{0.019855071751231884, 0.10166676129318663, 0.2372337950418355, 0.4082826787521751,0.5917173212478249,0.7627662049581645,0.8983332387068134,0.9801449282487681};
constexpr std::array<double, nodes> weight{0.05061426814518813,0.11119051722668724,0.15685332293894363,0.18134189168918100,0.18134189168918100,0.15685332293894363,0.11119051722668724,0.05061426814518813};
#endif
using Nodes = std::array<double, nodes>;

constexpr double gone = 28.0;  // a density below exp(-28) = 7e-13 is dropped

// Volume/pi of the cap of a unit sphere of height u: Eq. 2.
double cap(double u) { return u * u * (1.0 - u / 3.0); }

// f = kappa (p y)^k + ... at height y above the front of a column where the front's slope has cosine p.
double front_coefficient(const Shape& shape) {
  return shape.kind() == Shape::Kind::power ? std::pow(2.0, shape.order()) : 1.0;
}

// All bone that the burr's front meets at the same immersion s, whatever its lateral radius: a surface
// with the shape of the front, from the axis (p = 1) to where it leaves the bone's plane (p = 1 - s).
struct Slice {
  double s;
  double volume;   // / pi
  Nodes p;         // cosine of the front's slope, = height of the burr's centre above the front
  Nodes exponent;  // -log(density)
  Nodes dose;      // int f dH over the present step

  Slice(double begin, double end) : s(0.5 * (begin + end)), volume(cap(end) - cap(begin)), exponent{} {
    for (int j = 0; j < nodes; ++j) p[j] = std::sqrt(1.0 - s * (2.0 - s) * node[j]);
  }
};

// int f dH while the height above the front goes from y0 to y1. The factor y^k of f is integrated
// exactly, the rest by the midpoint rule.
void set_dose(Slice& slice, const Shape& shape, double y0, double y1) {
  const double y = 0.5 * (y0 + y1), k = shape.order();
  double length = y1 - y0;
  if (k > 0.0 && k != 1.0)
    length = (std::pow(y1 / y, k + 1.0) - std::pow(y0 / y, k + 1.0)) * y / (k + 1.0);
  for (int j = 0; j < nodes; ++j) {
    const double w = std::max(0.0, y * (2.0 * slice.p[j] - y));  // 1 - x^2
    slice.dose[j] = length * shape.at_depth(w / (1.0 + std::sqrt(std::max(0.0, 1.0 - w))));
  }
}

class Layer {
 public:
  Layer(const Shape& shape, double contact, int count) : shape_(shape), target_(cap(contact)) {
    for (int i = 0; i < count; ++i) slices_.emplace_back(contact * i / count, contact * (i + 1) / count);
  }

  // Time per immersion 1/v in a step from `from` to `to` that brings the mass back to Eq. 2.
  double advance(double from, double to, double guess) {
    slices_.emplace_back(from, to);
    for (std::size_t i = first_; i < slices_.size(); ++i)
      set_dose(slices_[i], shape_, std::max(0.0, from - slices_[i].s), to - slices_[i].s);
    const double slowness = solve(guess);
    for (std::size_t i = first_; i < slices_.size(); ++i)
      for (int j = 0; j < nodes; ++j) slices_[i].exponent[j] += slowness * slices_[i].dose[j];
    while (*std::min_element(slices_[first_].exponent.begin(), slices_[first_].exponent.end()) > gone) ++first_;
    return slowness;
  }

 private:
  // Newton's method. The mass is a convex and falling function of the slowness, so that from the left
  // no step goes too far and from the right only the first one does.
  double solve(double slowness) const {
    for (int iteration = 0; iteration < 100; ++iteration) {
      double mass = 0.0, loss = 0.0;
      for (std::size_t i = first_; i < slices_.size(); ++i) {
        const Slice& slice = slices_[i];
        double part = 0.0, part_loss = 0.0;
        for (int j = 0; j < nodes; ++j) {
          const double density = weight[j] * std::exp(-slice.exponent[j] - slowness * slice.dose[j]);
          part += density;
          part_loss += density * slice.dose[j];
        }
        mass += slice.volume * part;
        loss += slice.volume * part_loss;
      }
      const double next = std::max(0.0, slowness + (mass - target_) / loss);
      if (std::abs(mass - target_) < 1e-12 * target_) break;
      slowness = next;
    }
    return slowness;
  }

  Shape shape_;
  double target_;
  std::vector<Slice> slices_;
  std::size_t first_ = 0;
};

double immersion_step(const Shape& shape, double phi, double stop) {
  const double k = shape.order(), v = thin_layer_velocity(shape, phi, stop);
  const double layer = std::tgamma((k + 2.0) / (k + 1.0)) *
                       std::pow((k + 1.0) * v / front_coefficient(shape), 1.0 / (k + 1.0));
  return layer / (LD + 2.0 * k);
}

}  // namespace

MeanFieldDescent mean_field_descent(const Shape& shape, double phi, double stop, double resolution) {
  require_positive("phi", phi);
  require_positive("resolution", resolution);
  if (!(stop > 0.0 && stop <= 1.0)) refuse("stop", "in (0, 1]", stop);
  if (!(phi < stop * std::sqrt(stop))) refuse("phi", "below stop^1.5, beyond which static contact passes the stop", phi);
  const double contact = std::cbrt(phi * phi), step = immersion_step(shape, phi, stop) / resolution;
  const int steps = static_cast<int>(std::ceil(std::max((stop * stop - contact * contact) / (2.0 * step * stop), MS * resolution)));
  Layer layer(shape, contact, static_cast<int>(std::ceil((CD + 8.0 * shape.order()) * resolution)));
  MeanFieldDescent descent{{0.0}, {contact}};
  double slowness = 0.0, previous = 0.0;
  for (int n = 1; n <= steps; ++n) {
    const double from = descent.immersion.back();
    const double to = n < steps ? std::sqrt(contact * contact + (stop * stop - contact * contact) * n / steps) : stop;
    const double now = layer.advance(from, to, n > 2 ? 2.0 * slowness - previous : slowness);
    previous = slowness;
    slowness = now;
    descent.time.push_back(descent.time.back() + slowness * (to - from));
    descent.immersion.push_back(to);
  }
  return descent;
}

double thin_layer_velocity(const Shape& shape, double phi, double immersion) {
  require_positive("phi", phi);
  if (!(immersion > 0.0 && immersion <= 1.0)) refuse("immersion", "in (0, 1]", immersion);
  const double k = shape.order(), q = (k + 2.0) / (k + 1.0);
  const double area = 2.0 * (1.0 - std::pow(1.0 - immersion, q)) / q;
  return front_coefficient(shape) / (k + 1.0) *
         std::pow(cap(std::cbrt(phi * phi)) / (std::tgamma(q) * area), k + 1.0);
}

double window_velocity(const std::vector<double>& time, const std::vector<double>& immersion, double start,
                       double stop) {
  if (time.size() != immersion.size() || time.size() < 2)
    throw std::invalid_argument("time and immersion must be of one length, two points or more");
  std::vector<double> t, h;
  auto at = [&](double level) {
    std::size_t i = std::upper_bound(immersion.begin(), immersion.end(), level) - immersion.begin();
    i = std::min(std::max<std::size_t>(i, 1), immersion.size() - 1);
    return time[i - 1] + (time[i] - time[i - 1]) * (level - immersion[i - 1]) / (immersion[i] - immersion[i - 1]);
  };
  t.push_back(at(start));
  h.push_back(start);
  for (std::size_t i = 0; i < time.size(); ++i)
    if (immersion[i] > start && immersion[i] < stop) t.push_back(time[i]), h.push_back(immersion[i]);
  t.push_back(at(stop));
  h.push_back(stop);
  double sum_h = 0.0, sum_th = 0.0;
  const double middle = 0.5 * (t.front() + t.back()), span = t.back() - t.front();
  for (std::size_t i = 1; i < t.size(); ++i) {
    const double dt = t[i] - t[i - 1], ta = t[i - 1] - middle, tb = t[i] - middle, ha = h[i - 1] - start, hb = h[i] - start;
    sum_th += dt * (2.0 * ta * ha + 2.0 * tb * hb + ta * hb + tb * ha) / 6.0;
  }
  (void)sum_h;
  return sum_th * 12.0 / (span * span * span);
}

}  // namespace burrlab
