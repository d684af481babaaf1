// The simulated hand's mechanics against closed forms; tests/python/test_devices.py has its push.
#include "session/hand_device.hpp"

#include <array>
#include <cmath>

#include "check.hpp"
#include "count_allocations.hpp"

using namespace burrlab;

namespace {

HandSettings still() {
  HandSettings s;
  s.strokes = 0.0;
  s.start = Vec3(0.0, 0.0, 3.0);
  return s;
}

/// The stability limit of a sampled spring: a mass, damping b, k held over T. The mean of the discrete
/// system's eigenvalues gives the sign of the growth; a step across the limit must reverse it.
void check_edge_of_stability() {
  HandSettings s = still();
  s.damping = 2.0;
  s.push = 0.0;
  s.grip = 1e-9;
  s.start[2] = 2.999;
  // Mass and damper over T with the force held, in mm and s: the eigenvalues are on the unit circle where the
  // determinant of the step matrix is 1.
  const double m = 1e-4, b = 2e-3, period = 1e-3, a = std::exp(-b / m * period);
  const double reach = (1.0 - a) * m / b, drift = (period - reach) / b;
  const double edge = (1.0 - a) / (reach / m * reach - a * drift);
  CHECK_NEAR(edge, 2.0 * b / period, 0.03 * edge);  // near 2 b/T = 4 N/mm
  // Determinant of [[1 - k drift, reach], [-k reach/m, a]] is a - k (a drift - reach^2/m).
  for (const double part : {0.98, 1.02}) {
    HandDevice hand(s);
    hand.start(period);
    double early = 0.0, late = 0.0;
    for (int i = 0; i < 8000; ++i) {
      const double x = hand.read(i * period, 1).position[2] - 3.0;
      hand.write(Vec3(0.0, 0.0, -part * edge * x));
      if (i < 1000) early = std::max(early, std::abs(x));
      if (i >= 7000) late = std::max(late, std::abs(x));
    }
    CHECK(part < 1.0 ? late < 0.8 * early : late > 1.25 * early);
  }
}

/// Free motion: damping is exact for any number of steps.
void check_free_motion() {
  HandSettings s = still();
  s.grip = 1e-9;
  s.push = 0.0;
  s.damping = 5.0;
  HandDevice hand(s);
  hand.start(1e-3);
  hand.read(0.0, 1);
  hand.write(Vec3(0.5, 0.0, 0.0));
  hand.read(0.0, 20);  // 20 ms under 0.5 N: v = F/b (1 - e^{-t b/m})
  const double tau = 0.1 / 5.0, t = 0.02, terminal = 0.5 / 5.0 * 1e3;
  CHECK_NEAR(hand.velocity()[0], terminal * (1.0 - std::exp(-t / tau)), 1e-6);
  CHECK_NEAR(hand.position()[0], terminal * (t - tau * (1.0 - std::exp(-t / tau))), 1e-6);
  hand.halt();
  hand.read(0.0, 400);  // without a force it comes to rest
  CHECK(std::abs(hand.velocity()[0]) < 1e-6);
  hand.write(Vec3(9.0, 0.0, 0.0));
  CHECK(hand.force().isZero(0.0));
}

/// The same time in one reading or in many.
void check_periods() {
  HandDevice one(still()), many(still());
  one.start(1e-3), many.start(1e-3);
  one.read(0.0, 1), many.read(0.0, 1);
  one.write(Vec3(0.1, 0.2, 0.0)), many.write(Vec3(0.1, 0.2, 0.0));
  const DeviceReading a = one.read(0.008, 8);
  for (int i = 0; i < 8; ++i) many.read(0.001 * i, 1);
  CHECK((a.position - many.position()).norm() < 1e-12 && (one.velocity() - many.velocity()).norm() < 1e-9);
}

/// Below the friction nothing moves; above it a mass slides as under a smaller force; it stops, and stays.
void check_friction() {
  HandSettings s = still();
  s.grip = 1e-9;
  s.push = 0.0;
  s.damping = 0.0;
  s.friction = 0.1;
  HandDevice hand(s);
  hand.start(1e-3);
  hand.read(0.0, 1);
  hand.write(Vec3(0.06, -0.06, 0.0));  // 0.085 N
  hand.read(0.0, 500);
  CHECK(hand.position() == s.start && hand.velocity().isZero(0.0));
  hand.write(Vec3(0.3, 0.0, 0.0));
  hand.read(0.0, 10);
  CHECK_NEAR(hand.velocity()[0], 0.2 / 0.1 * 0.01 * 1e3, 1e-6);  // (0.3 - 0.1) N, 0.1 kg, 10 ms
  const double way = hand.position()[0], speed = hand.velocity()[0];
  hand.write(Vec3::Zero());
  hand.read(0.0, 100);  // decelerated by 1 m/s^2: v^2/2a
  CHECK(hand.velocity().isZero(0.0));
  CHECK_NEAR(hand.position()[0] - way, speed * speed / 2e3, 2e-4);
  hand.write(Vec3(0.0, 0.0999, 0.0));
  const Vec3 rest = hand.position();
  hand.read(0.0, 100);
  CHECK(hand.position() == rest);
}

void check_encoder() {
  HandSettings s = still();
  s.encoder_step = 0.03;
  s.start = Vec3(0.0, 0.0, 3.2);
  HandDevice hand(s);
  hand.start(1e-3);
  double last = hand.read(0.0, 1).position[2];
  int moved = 0;
  for (int i = 1; i < 300; ++i) {
    const DeviceReading now = hand.read(0.001 * i, 1);
    const double steps = now.position[2] / 0.03;
    CHECK_NEAR(steps, std::round(steps), 1e-9);
    CHECK(std::abs(now.position[2] - hand.position()[2]) <= 0.015 + 1e-12);
    CHECK_NEAR(now.velocity[2], (now.position[2] - last) / 1e-3, 1e-9);
    moved += now.position[2] != last;
    last = now.position[2];
  }
  CHECK(moved > 5);
}

void check_strokes() {
  HandSettings s;
  HandDevice hand(s);
  hand.start(1e-3);
  double most = 0.0, fastest = 0.0;
  int turns = 0;
  double before = 0.0;
  for (int i = 0; i < 6000; ++i) {
    const long allocated = allocations;
    const DeviceReading now = hand.read(0.001 * i, 1);
    hand.write(Vec3::Zero());
    CHECK(allocations == allocated);
    if (i < 1000) CHECK(hand.target()[0] == 0.0);
    if (i >= 2000) {
      most = std::max(most, std::abs(hand.target()[0]));
      fastest = std::max(fastest, std::abs(now.velocity[0]));
      turns += before <= 0.0 && hand.target()[0] > 0.0;
    }
    before = hand.target()[0];
  }
  CHECK_NEAR(most, 8.0, 1e-3);
  CHECK(turns == 5 || turns == 6);  // 4 s at 1.4 turns a second
  CHECK(fastest > 60.0 && fastest < 90.0);
}

/// Presses on a stiff and on a soft wall: from the first contact on, each as high as the push, with gaps.
void check_presses() {
  for (const double k : {4.0, 1.5}) {
    HandSettings s = still();
    s.push = 1.5;
    s.presses = 0.5;
    s.start[2] = 3.5;
    HandDevice hand(s);
    hand.start(1e-3);
    double touched = -1.0;
    std::array<double, 5> most{}, least;
    least.fill(INFINITY);
    for (int i = 0; i < 10500; ++i) {
      const long allocated = allocations;
      const DeviceReading now = hand.read(0.001 * i, 1);
      const double force = std::max(0.0, k * (3.0 - now.position[2]));
      hand.write(Vec3(0.0, 0.0, force));
      CHECK(allocations == allocated);
      if (touched < 0.0 && force > 0.0) touched = 0.001 * i;
      if (touched < 0.0) continue;
      const double turns = 0.5 * (0.001 * i - touched);
      if (turns >= 5.0) break;
      double& peak = most[std::size_t(turns)];
      peak = std::max(peak, force);
      if (turns - std::floor(turns) > 0.5)
        least[std::size_t(turns)] = std::min(least[std::size_t(turns)], force);
    }
    CHECK(touched > 0.09 && touched < 0.2);  // 0.5 mm at 5 mm/s
    for (const double peak : most) CHECK_NEAR(peak, s.push, 0.03 * s.push);
    for (const double force : least) CHECK(force < 0.05 * s.push);
    hand.start(1e-3);  // the next session waits for its own contact
    for (int i = 0; i < 50; ++i) {
      hand.read(0.001 * i, 1);
      hand.write(Vec3::Zero());
    }
    CHECK_NEAR(hand.position()[2], 3.5 - 5.0 * 0.05, 0.15);
  }
}

void check_switch() {
  HandSettings s = still();
  s.on_after = 0.01;
  HandDevice hand(s);
  hand.start(1e-3);
  for (int i = 0; i < 20; ++i) CHECK(hand.read(0.001 * i, 1).on == (i >= 10));
  s.on = false;
  CHECK(!HandDevice(s).read(1.0, 1).on);
}

void check_hand_refusals() {
  const auto with = [](auto change) {
    HandSettings s;
    change(s);
    return HandDevice(s).settings().push;
  };
  CHECK_THROWS(with([](HandSettings& s) { s.damping = -1.0; }), "damping must be zero or positive");
  CHECK_THROWS(with([](HandSettings& s) { s.grip = 0.0; }), "grip must be positive");
  CHECK_THROWS(with([](HandSettings& s) { s.friction = -0.1; }), "friction must be zero or positive");
  CHECK_THROWS(with([](HandSettings& s) { s.encoder_step = -0.1; }), "encoder_step must be zero or positive");
  CHECK_THROWS(with([](HandSettings& s) { s.follow = 0.0; }), "follow must be positive");
  CHECK_THROWS(with([](HandSettings& s) { s.approach = 0.0; }), "approach must be positive");
  CHECK_THROWS(with([](HandSettings& s) { s.strokes = -1.0; }), "strokes must be zero or positive");
  CHECK_THROWS(with([](HandSettings& s) { s.strokes_after = -1.0; }),
               "strokes_after must be zero or positive");
  CHECK_THROWS(with([](HandSettings& s) { s.amplitude = -1.0; }), "amplitude must be zero or positive");
  CHECK_THROWS(with([](HandSettings& s) { s.on_after = -1.0; }), "on_after must be zero or positive");
}

}  // namespace

int main() {
  check_edge_of_stability();
  check_free_motion();
  check_periods();
  check_friction();
  check_encoder();
  check_strokes();
  check_presses();
  check_switch();
  check_hand_refusals();
  return check::report();
}
