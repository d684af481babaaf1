// The loop's deadlines, and that it does not allocate while it runs.
#include "burrlab/session/haptic_loop.hpp"

#include <cmath>

#include "count_allocations.hpp"
#include "loop_scenes.hpp"
#include "session/device_frame.hpp"
#include "session/realtime.hpp"

using namespace burrlab;
using namespace scenes;

namespace {

void no_allocation() {
  LoopSettings settings = virtual_clock(5000);
  settings.guards = {GuardLimits{3.3, 1.0, 0.88, 10.0, 1.0}};
  Run run(settings);
  long first = 0, last = 0;
  run.device->what = [&](int n, DeviceReading&) {
    if (n == 0) first = allocations;
    if (n == 4999) last = allocations;
  };
  run.to_end();
  CHECK(run.loop->counts().ticks == 5000);
  CHECK(last == first);
  CHECK(run.loop->reason() == "all ticks were executed" && !run.loop->failed());
  CHECK(run.device->halted && run.device->last == Vec3::Zero());
}

/// Readings that take 3.5 and 20 periods: the next tick stands for them, up to 8.
void late_ticks() {
  LoopSettings settings;
  settings.ticks = 200;
  settings.stall_limit = 5000.0;  // other work on the machine is not a stall
  Run run(settings, 2.0);
  run.device->what = [](int n, DeviceReading&) {
    if (n == 50) sleep(7);
    if (n == 100) sleep(40);
  };
  run.to_end();
  const LoopCounts counts = run.loop->counts();
  TickRecord record;
  std::uint64_t periods = 0, sum_k = 0, late = 0;
  for (std::uint64_t i = 0; i < 200; ++i) {
    CHECK(run.loop->ring()->read(i, record));
    CHECK(record.index == i && record.k >= 1 && record.k <= 8);
    CHECK(record.k == std::min<std::uint64_t>(run.device->periods[i], 8));
    sum_k += record.k;
    periods += run.device->periods[i];
    late += record.k > 1;
  }
  CHECK(counts.late == late && counts.missed == periods - 200 && counts.dropped == periods - sum_k);
  CHECK(run.loop->ring()->read(51, record) && record.k >= 3);
  CHECK(run.loop->ring()->read(101, record) && record.k == 8);
  CHECK(run.device->periods[101] >= 19 && counts.dropped >= 11);
}

/// A device in a frame moves the burr as one that is there already, and feels the same force along its own
/// axes.
void frames() {
  const double half = std::sqrt(0.5);
  LoopSettings settings = virtual_clock(600);
  Run plain(settings);
  plain.to_end();
  settings.frames = {
      {4.0, {half, 0.0, 0.0, half}, Vec3(1.0, 2.0, 3.0), 1}};  // z turned by 90 degrees: (-y, x, z)
  Run framed(settings);
  Vec3 sent[600];
  framed.device->what = [&](int n, DeviceReading& r) {
    const Vec3 at = (r.position - Vec3(1.0, 2.0, 3.0)) / 4.0;
    r.position = Vec3(at[1], -at[0], at[2]);
    r.velocity = Vec3(0.0, -0.25, 0.0);
    if (n) sent[n - 1] = framed.device->last;
  };
  framed.to_end();
  TickRecord one, other;
  double most = 0.0;
  for (std::uint64_t i = 0; i < 600; ++i) {
    CHECK(plain.loop->ring()->read(i, one) && framed.loop->ring()->read(i, other));
    const BurrRecord &a = one.burr[0], &b = other.burr[0];
    for (int axis = 0; axis < 3; ++axis) {
      CHECK(std::abs(a.center[axis] - b.center[axis]) < 1e-12);
      CHECK(std::abs(a.sent[axis] - b.sent[axis]) < 1e-6);
    }
    most = std::max(most, to_vector(a.sent).norm());
    CHECK(std::abs(b.device_velocity[0] - 1.0) < 1e-12);
    CHECK(std::abs(b.orientation[0] - half) < 1e-12 && std::abs(b.orientation[3] - half) < 1e-12);
    if (i < 599) CHECK((sent[i] - Vec3(b.sent[1], -b.sent[0], b.sent[2])).norm() < 1e-12);
  }
  CHECK(most > 0.05);

  // Button 1 held from 100 to 199: the burr stays, without force; afterwards it goes on from there.
  Run clutched(settings);
  clutched.device->what = [](int n, DeviceReading& r) {
    r.position = Vec3(0.01 * n, 0.0, -0.4);
    if (n >= 100 && n < 200) r.buttons = 2;
  };
  clutched.to_end();
  for (std::uint64_t i = 99; i < 300; ++i) {
    CHECK(clutched.loop->ring()->read(i, one));
    const BurrRecord& burr = one.burr[0];
    const double moved = i < 200 ? 0.99 : 0.99 + 0.01 * double(i - 199);
    CHECK((to_vector(burr.center) - Vec3(1.0, 2.0 + 4.0 * moved, 1.4)).norm() < 1e-9);
    CHECK(burr.on == (i < 100 || i >= 200) && burr.buttons == (i >= 100 && i < 200 ? 2 : 0));
    if (i >= 120 && i < 200) CHECK(to_vector(burr.sent).norm() == 0.0);
  }
}

void clocks() {
  const std::int64_t now = steady_now();
  CHECK(steady_after(1e300) > now + 1000000000000 && steady_after(HUGE_VAL) > now + 1000000000000);
  CHECK(steady_after(-1.0) - now < 1000000000 && steady_after(NAN) - now < 1000000000);
  CHECK(steady_after(1.0) - now >= 1000000000);
}

void refusals() {
  const auto one = executor();
  const auto device = std::make_shared<TestDevice>();
  CHECK_THROWS(HapticLoop(one, {}, {}), "number of devices must be one a burr, 1, got 0");
  CHECK_THROWS(HapticLoop(one, {nullptr}, {}), "device must be a Device, got None");
  CHECK_THROWS(HapticLoop(executor(0.01), {device}, {}), "rate must be at most 10000 Hz, got 100000");
  LoopSettings settings;
  settings.stall_limit = 0.0;
  CHECK_THROWS(HapticLoop(one, {device}, settings), "stall_limit must be positive");
  CHECK_THROWS(HapticLoop(executor(51.0), {device}, {}), "period must be at most half the limit of a stall");
  CHECK_THROWS(executor(1.0, 3), "number of burrs must be 1 or 2, got 3");
  CHECK_THROWS(executor(0.0), "period must be positive");
  settings = {};
  settings.frames.resize(2);
  CHECK_THROWS(HapticLoop(one, {device}, settings), "number of frames must be one a burr, 1, got 2");
  CHECK_THROWS(FramedDevice({0.0}), "scale of a frame must be positive");
  CHECK_THROWS(FramedDevice({1.0, {0.0, 0.0, 0.0, 0.0}}), "length of rotation of a frame must be 1, got 0");
  CHECK_THROWS(FramedDevice({1.0, {1.0, 0.0, 0.0, 0.0}, Vec3(0.0, NAN, 0.0)}),
               "offset of a frame must be finite");
  CHECK_THROWS(FramedDevice({1.0, {1.0, 0.0, 0.0, 0.0}, Vec3::Zero(), 8}),
               "clutch must be -1 or a button, 0 to 7");
  CHECK_THROWS(executor(2000.0), "alpha dt must be at most 1000");
}

}  // namespace

int main() {
  no_allocation();
  late_ticks();
  frames();
  clocks();
  refusals();
  return check::report();
}
