// The virtual coupling: balance, its error, continuity, the stiffness at the hand, free space.
#include "session/virtual_coupling.hpp"

#include <algorithm>

#include "check.hpp"
#include "count_allocations.hpp"
#include "session_scenes.hpp"

using namespace burrlab;

namespace {

struct Worst {
  double residual = 0.0, error = 0.0, jump = -1.0, force = 0.0;
  int probes = 0, entries = 0;
};

/// A device along z = top + 0.3 - depth (1 - cos)/2, with a sideways swing, tick by tick.
Worst press(const TickExecutor& executor, VirtualCoupling& coupling, double top, double depth, double side,
            int ticks) {
  Worst worst;
  Coupled last;
  Vec3 last_device = Vec3::Zero();
  bool was_in = false;
  for (int i = 0; i < ticks; ++i) {
    const double turn = 2.0 * 3.14159265358979323846 * i / ticks * 3.0;  // three times in and out
    const Vec3 device(side * std::sin(0.37 * turn), 0.0,
                      top + 0.3 - (depth + 0.3) * 0.5 * (1.0 - std::cos(turn)));
    const long before = allocations;
    const Coupled now = coupling.couple(executor, 0, device);
    CHECK(allocations == before);
    CHECK(now.probes <= 4);
    CHECK((now.force - coupling.stiffness() * (now.center - device)).norm() < 1e-12);
    const Vec3 felt = executor.probe(0, now.center).force;
    CHECK_NEAR((felt - now.force).norm(), now.residual, 1e-12);
    if (executor.probe(0, device).force.isZero(0.0) && felt.isZero(0.0)) CHECK(now.center == device);
    // Repeats at the same place until nothing moves: the balance itself.
    VirtualCoupling patient = coupling;
    Coupled settled = now;
    for (int turn = 0; turn < 20 && settled.residual > 2e-4; ++turn)
      settled = patient.couple(executor, 0, device);
    worst.error = std::max(worst.error, (settled.force - now.force).norm());
    worst.residual = std::max(worst.residual, now.residual);
    worst.probes = std::max(worst.probes, now.probes);
    worst.force = std::max(worst.force, now.force.norm());
    // Exact balances differ by at most k_c times the device's way; each is missed by at most its residual.
    if (i > 0) {
      const double due = coupling.stiffness() * (device - last_device).norm();
      worst.jump = std::max(worst.jump, (now.force - last.force).norm() - due - now.residual - last.residual);
    }
    const bool in = now.force.norm() > 0.0;
    worst.entries += in && !was_in;
    was_in = in;
    last = now;
    last_device = device;
  }
  return worst;
}

void check_press(double hole, double stiffness, double depth, double side) {
  const auto executor = scenes::executor(scenes::block_with_hole(3.0, hole), scenes::bone_material);
  VirtualCoupling coupling(stiffness);
  const Worst worst = press(executor, coupling, 3.0 - hole, depth, side, 3000);
  std::printf(
      "hole %.1f mm, k_c %g N/mm, side %g mm: residual %.4f N, error %.4f N, jump %.2g N, probes %d, force "
      "%.2f N\n",
      hole, stiffness, side, worst.residual, worst.error, worst.jump, worst.probes, worst.force);
  CHECK(worst.force > 0.2 && worst.entries >= 3);
  CHECK(worst.residual < 0.06 && worst.error < 0.02);
  CHECK(worst.jump < 1e-3);
}

/// Steps of the device, as from a peer that sends rarely: after any step, the next ticks find the balance.
void check_steps() {
  const auto executor = scenes::executor(scenes::block_with_hole(3.0, 1.0), scenes::bone_material);
  VirtualCoupling coupling(2.0);
  for (int i = 0; i < 200; ++i) {
    const Vec3 device(0.3 * std::sin(1.7 * i), 0.3 * std::cos(2.3 * i),
                      2.0 - 0.8 * std::abs(std::sin(0.9 * i)));
    Coupled now = coupling.couple(executor, 0, device);
    CHECK(now.force.allFinite() && now.force.norm() < 3.0);
    for (int tick = 0; tick < 5; ++tick) now = coupling.couple(executor, 0, device);
    CHECK(now.residual < 0.01);
  }
  const Coupled lost = coupling.couple(executor, 0, Vec3(0.0, std::nan(""), 0.0));
  CHECK(lost.force.isZero(0.0) && lost.probes == 0);
  coupling.reset();
  const Coupled far = coupling.couple(executor, 0, Vec3(0.0, 0.0, 100.0));
  CHECK(far.center == Vec3(0.0, 0.0, 100.0) && far.force.isZero(0.0) && far.probes == 1);
  CHECK_THROWS(VirtualCoupling(0.0), "stiffness of the coupling must be positive and finite, got 0");
  CHECK_THROWS(VirtualCoupling(5e-324), "stiffness of the coupling must be at least 1e-6 N/mm, got");
}

/// The hand meets contact and spring in series, k k_c/(k + k_c), never more than the spring.
void check_series() {
  const auto executor = scenes::executor(scenes::block_with_hole(3.0, 1.0), scenes::bone_material);
  VirtualCoupling coupling(2.0);
  const auto settle = [&](double z) {
    Coupled now;
    for (int i = 0; i < 10; ++i) now = coupling.couple(executor, 0, Vec3(0.0, 0.0, z));
    return now;
  };
  for (const double z : {1.8, 1.6, 1.4}) {
    const Coupled in = settle(z - 0.01), out = settle(z + 0.01);
    const double met = (in.force - out.force)[2] / 0.02;
    const double contact = (in.force - out.force)[2] / (out.center - in.center)[2];
    CHECK_NEAR(met, contact * 2.0 / (contact + 2.0), 0.03);
    CHECK(met > 1.2 && met < 2.0);
  }
}

}  // namespace

int main() {
  check_steps();
  check_series();
  for (const double stiffness : {0.5, 2.0, 8.0})
    for (const double hole : {0.0, 1.0})
      for (const double side : {0.0, 0.3}) check_press(hole, stiffness, 0.6, side);
  return check::report();
}
