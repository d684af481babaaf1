// Force limit, slew limit, and the observer's energy.
#include "burrlab/session/force_guard.hpp"

#include <random>

#include "burrlab/session/passivity_observer.hpp"
#include "check.hpp"

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
  observer.reset();
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
  check_energy_of_sampling();
  return check::report();
}
