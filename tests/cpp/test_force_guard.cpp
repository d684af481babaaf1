// Force limit, slew limit, and the observer's energy.
#include "session/force_guard.hpp"

#include <random>

#include "check.hpp"
#include "session/passivity_observer.hpp"

using namespace burrlab;

namespace {

void check_limit_keeps_direction() {
  ForceGuard guard(2.0, 100.0);
  const Vec3 small(0.5, -1.0, 1.2);
  CHECK(guard.apply(small, 1.0) == small);
  const Vec3 large(30.0, -40.0, 120.0), sent = guard.apply(large, 1.0);
  CHECK_NEAR(sent.norm(), 2.0, 1e-14);
  CHECK_NEAR(sent.normalized().dot(large.normalized()), 1.0, 1e-14);
  CHECK_NEAR(guard.apply(Vec3::Constant(1.7e308), 1.0).norm(), 2.0, 1e-14);  // its length overflows
}

void check_slew() {
  ForceGuard guard(5.0, 0.25);
  double expected = 0.0;
  for (int i = 0; i < 30; ++i) {
    expected = std::min(5.0, expected + 0.25);
    CHECK_NEAR(guard.apply(Vec3(0.0, 0.0, 9.0), 1.0)[2], expected, 1e-14);
  }
  CHECK_NEAR(guard.apply(Vec3::Zero(), 3.0)[2], 4.25, 1e-14);  // three periods, three steps
  const Vec3 last = guard.apply(Vec3::Zero(), 0.0);
  CHECK_NEAR(last[2], 4.25, 1e-14);
  CHECK(guard.apply(Vec3::Zero(), -1.0) == last && guard.apply(Vec3::Zero(), std::nan("")) == last);
  guard.reset();
  CHECK(guard.apply(Vec3::Zero(), 1.0).norm() == 0.0);
}

void check_whatever_comes() {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> exponent(-300.0, 300.0), sign(-1.0, 1.0);
  const double odd[] = {std::nan(""), INFINITY, -INFINITY, 0.0, 5e-324, 1.7e308};
  ForceGuard guard(8.0, 1.0);
  Vec3 last = Vec3::Zero();
  for (int i = 0; i < 100000; ++i) {
    Vec3 wanted;
    for (int axis = 0; axis < 3; ++axis)
      wanted[axis] = random() % 20 == 0 ? odd[random() % 6] : sign(random) * std::pow(10.0, exponent(random));
    const double dt = double(random() % 9);
    const Vec3 sent = guard.apply(wanted, dt);
    CHECK(sent.allFinite() && sent.norm() <= 8.0 + 1e-12 && (sent - last).norm() <= dt + 1e-12);
    last = sent;
  }
  CHECK_THROWS(ForceGuard(0.0, 1.0), "force limit must be positive and finite, got 0");
  CHECK_THROWS(ForceGuard(1.0, std::nan("")), "slew limit must be positive and finite");
}

// One session's forces: steps, turns, trembling, noise and nonsense; late ticks, and devices that come back.
struct Demand {
  explicit Demand(std::mt19937& random, double limit) : random(random), limit(limit) { turn(); }
  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  }
  void turn() {
    size = limit * std::pow(10.0, uniform(-2.0, 1.0)) * double(random() % 4 != 0);
    direction = Vec3(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1)).normalized();
    noise = random() % 3 == 0 ? size : 0.0;
    flips = random() % 4 == 0;
    spin = random() % 3 == 0 ? std::pow(10.0, uniform(-4.0, 0.0)) : 0.0;
  }
  Vec3 next() {
    if (random() % 200 == 0) turn();
    if (random() % 500 == 0) return Vec3(std::nan(""), INFINITY, 1.0);
    if (flips) direction = -direction;
    const Vec3 d = direction;
    direction = (d + spin * Vec3(d[1] - d[2], d[2] - d[0], d[0] - d[1])).normalized();
    return size * direction + noise * Vec3(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
  }
  std::mt19937& random;
  double limit, size = 0.0, noise = 0.0, spin = 0.0;
  Vec3 direction;
  bool flips = false;
};

// No sent force exceeds peak, slew, continuous limit or ramp, in 10 000 sessions of 500 to 2000 ticks. The
// mean square is followed here with the exponential function itself, to the end of each force's longest hold.
void check_limits_of_a_model() {
  std::mt19937 random(11);
  double nearest = 0.0;
  std::uint64_t held = 0, ramped = 0;
  for (int session = 0; session < 10000; ++session) {
    const double period = random() % 2 ? 1.0 : 0.25, hold = random() % 2 ? 100.0 : 8.0;
    Demand demand(random, std::pow(10.0, std::uniform_real_distribution<double>(0.0, 1.6)(random)));
    GuardLimits limits{demand.limit};
    limits.slew = demand.limit * std::pow(10.0, demand.uniform(-3.0, 0.0));
    const double reserve = std::pow(10.0, demand.uniform(-2.0, -0.01));
    limits.window = 1e-3 * (hold + limits.force / limits.slew) / reserve;
    if (random() % 8) limits.continuous = demand.limit * demand.uniform(0.05, 1.1);
    if (random() % 3) limits.ramp = demand.uniform(0.01, 1.0);
    ForceGuard guard(limits, hold);
    const double most = limits.continuous * limits.continuous * (1.0 + 1e-12);
    const auto decayed = [&](double mean, double square, double time) {
      return square + (mean - square) * std::exp(-1e-3 * time / limits.window);
    };
    Vec3 last = Vec3::Zero();
    double mean = 0.0, time = 0.0, work = 0.0, touched = -1.0;
    const int ticks = 500 + int(random() % 1500);
    for (int tick = 0; tick < ticks; ++tick) {
      if (random() % 1000 == 0) {
        guard.reset();
        last.setZero();
        touched = -1.0;
      }
      const double dt = random() % 50 == 0 ? demand.uniform(0.0, hold) : period;
      mean = decayed(mean, last.squaredNorm(), dt);
      work += last.squaredNorm() * dt;
      time += dt;
      const Vec3 wanted = demand.next(), sent = guard.apply(wanted, dt);
      if (touched < 0.0 && wanted.allFinite() && wanted.norm() > 0.0) touched = time;
      const double force = sent.norm();
      CHECK(sent.allFinite() && force <= limits.force * (1.0 + 1e-12));
      CHECK((sent - last).norm() <= limits.slew * dt + 1e-12 * limits.force);
      CHECK(decayed(mean, force * force, 0.0) <= most && decayed(mean, force * force, hold) <= most);
      const double known = guard.mean_square();
      CHECK(known + reserve * (force * force - known) <= most);  // the guard's rule
      CHECK(std::isinf(most) || mean <= known * (1.0 + 1e-12));
      if (limits.ramp > 0.0)
        CHECK(force <= limits.force * (touched < 0.0 ? 0.0 : 1e-3 * (time - touched) / limits.ramp) + 1e-9);
      const double free = wanted.allFinite() ? std::min(wanted.norm(), limits.force) : 0.0;
      if (touched >= 0.0 && time - touched < 1e3 * limits.ramp)
        ramped += force < 0.99 * free;
      else
        held += force < 0.99 * free && mean > 0.9 * most;
      nearest = std::max(nearest, mean / most);
      last = sent;
    }
    const double plain = std::sqrt(work / time), all = std::sqrt(1.0 + 1e3 * limits.window / time);
    CHECK(plain <= limits.continuous * all * (1.0 + 1e-9));
  }
  CHECK(nearest > 0.999 && held > 100000 && ramped > 100000);  // the limits were reached
}

// A force that is wanted for long falls to the continuous limit, not to zero, and one below is never touched.
void check_continuous_limit_holds_level() {
  GuardLimits limits{3.3, 1.0, 0.88};
  ForceGuard guard(limits), gentle(limits);
  double least = 9.0, since = 0.0;
  for (int i = 0; i < 120000; ++i) {
    const double force = guard.apply(Vec3(0.0, 3.0, 4.0), 1.0).norm();
    if (force > 3.2) since = i;
    if (i > 10) least = std::min(least, force);
    CHECK(gentle.apply(Vec3(0.0, 0.0, 0.88), 1.0)[2] == 0.88);
  }
  CHECK(since > 500 && since < 800 && least > 0.879);  // 10 s ln(F^2/(F^2 - c^2)) = 0.74 s at 3.3 N
  CHECK_THROWS(ForceGuard(GuardLimits{3.3, 1.0, std::nan("")}), "continuous limit must be positive");
  CHECK_THROWS(ForceGuard(GuardLimits{3.3, 1.0, 0.88, -1.0}), "window must be positive and finite");
  CHECK_THROWS(ForceGuard(GuardLimits{3.3, 1.0, 0.88, 0.1}), "window must be at least a stall");
  CHECK_THROWS(ForceGuard(GuardLimits{3.3, 1.0, 0.88, 10.0, std::nan("")}), "ramp must be from 0");
}

// A sampled spring k, pressed in at v and let out again. The force lags by half a period, so a full stroke
// gives k v T over its length, 2 x (k v T x depth)/2.
void check_energy_of_sampling() {
  const double k = 4.0, speed = 20.0, period = 1e-3, depth = 0.5;
  PassivityObserver observer;
  const int ticks = int(depth / (speed * period));
  double lowest = 0.0;
  for (int i = 0; i <= 2 * ticks; ++i) {
    const double z = -depth + std::abs(i - ticks) * speed * period + (depth - 0.5);
    observer.update(Vec3(1.0, 2.0, z), Vec3(0.0, 0.0, k * (0.5 - depth - z + depth - 0.5)));
    lowest = std::min(lowest, observer.energy());
  }
  CHECK(lowest < -0.4 * k * depth * depth);
  CHECK_NEAR(observer.energy(), k * speed * period * depth, 1e-12);
  CHECK(observer.most() == observer.energy());
  observer = {};
  CHECK(observer.energy() == 0.0 && observer.most() == 0.0);
  observer.update(Vec3(5.0, 0.0, 0.0), Vec3(1.0, 0.0, 0.0));
  CHECK(observer.energy() == 0.0);  // no work without a displacement
  observer.update(Vec3(4.0, 3.0, 0.0), Vec3::Zero());
  CHECK(observer.energy() == -1.0);
}

}  // namespace

int main() {
  check_limit_keeps_direction();
  check_slew();
  check_whatever_comes();
  check_limits_of_a_model();
  check_continuous_limit_holds_level();
  check_energy_of_sampling();
  return check::report();
}
