// The ends of a loop: without a fault, on a fault, before it began.
#include "burrlab/session/haptic_loop.hpp"

#include <cmath>

#include "loop_scenes.hpp"
#include "session/follower.hpp"
#include "session/hand_device.hpp"
#include "session/realtime.hpp"
#include "session/scripted_device.hpp"

using namespace burrlab;
using namespace scenes;

namespace {

void ends() {
  {
    Run run(virtual_clock(1000));
    run.device->what = [](int n, DeviceReading& r) {
      if (n == 10) r.position[1] = std::nan("");
    };
    run.to_end();
    CHECK(run.loop->failed() && run.loop->counts().ticks == 10);
    CHECK(run.loop->reason() == "device 0 gave a position or velocity that is not finite");
  }
  for (const double w : {0.0, 1.1, std::nan("")}) {
    Run run(virtual_clock(1000));
    run.device->what = [w](int n, DeviceReading& r) {
      if (n == 10) r.orientation[0] = w;
    };
    run.to_end();
    CHECK(run.loop->failed() && run.loop->counts().ticks == 10);
    CHECK(run.loop->reason() == "device 0 gave an orientation that is not a quaternion of length 1");
  }
  {
    Run run(virtual_clock(1000));
    run.device->what = [](int n, DeviceReading& r) {
      if (n >= 20) r.status = DeviceReading::Status::lost, r.age = 101.4;
    };
    run.to_end();
    CHECK(run.loop->failed() && run.loop->reason() == "device 0 was lost: its last position is 101 ms old");
    CHECK(run.device->last == Vec3::Zero());
  }
  {
    std::vector<std::string> messages;
    LoopSettings settings = virtual_clock(1000);
    settings.message = [&](const std::string& sentence) { messages.push_back(sentence); };
    Run run(settings);
    run.device->what = [](int n, DeviceReading& r) {
      if (n < 5) r.status = DeviceReading::Status::waiting;
      if (n == 35) r.status = DeviceReading::Status::finished;
    };
    run.to_end();
    CHECK(!run.loop->failed() && run.loop->counts().ticks == 30);
    CHECK(run.loop->reason() == "device 0 has come to its end");
    CHECK(messages == std::vector<std::string>{run.loop->reason()});
  }
}

/// A user's rules end the session within the tick, its record complete and no force sent.
void stops() {
  {
    LoopSettings settings = virtual_clock(1000);
    settings.stop_buttons = 0b100;
    Run run(settings);
    run.device->what = [](int n, DeviceReading& r) { r.buttons = n < 20 ? 0b011 : 0b110; };
    run.to_end();
    CHECK(!run.loop->failed() && run.loop->reason() == "a stop button of device 0 was pressed");
    CHECK(run.loop->counts().ticks == 20 && run.device->last == Vec3::Zero());
  }
  LoopSettings settings = virtual_clock(1000);
  settings.stop_force = 0.5;
  Run run(settings);
  run.device->what = [](int n, DeviceReading& r) { r.position[2] = 1.5 - 0.001 * n; };
  RecordReader reader(run.loop->ring());
  run.to_end();
  CHECK(!run.loop->failed() && run.loop->reason() == "the force of burr 0 reached 0.5 N");
  CHECK(run.device->last == Vec3::Zero());
  TickRecord record;
  std::uint64_t ticks = 0;
  for (; reader.next(record) == RecordReader::Result::record; ++ticks) {
    const bool last = ticks + 1 == run.loop->counts().ticks;
    const Vec3 force = to_vector(record.burr[0].force);
    CHECK((force.norm() >= 0.5) == last && (to_vector(record.burr[0].sent).norm() == 0.0 || !last));
  }
  CHECK(ticks > 1 && ticks == run.loop->counts().ticks && ticks == run.loop->executor()->tick());
  settings.stop_force = std::nan("");
  CHECK_THROWS(Run{settings}, "stop_force must be positive");
  settings = virtual_clock(10);
  settings.guards.resize(2);
  CHECK_THROWS(Run{settings}, "number of guards must be one a burr, 1, got 2");
}

/// A device that is gone for a while feels no force meanwhile, and its force grows from zero again.
void comes_back() {
  LoopSettings settings = virtual_clock(400);
  settings.guards = {GuardLimits{4.0, 1.0, std::numeric_limits<double>::infinity(), 10.0, 0.1}};
  Run run(settings);
  std::vector<double> felt;
  run.device->what = [&](int n, DeviceReading& r) {
    felt.push_back(run.device->last.norm());
    r.on = false;
    r.position = Vec3(0.0, 0.0, 0.9);
    if (n >= 200 && n < 230) r.status = DeviceReading::Status::waiting;
  };
  run.to_end();
  const double pressed = felt[199];
  CHECK(pressed > 1.0 && felt.size() == 430);
  for (int n = 0; n < 430; ++n) {  // the reading of n shows the force of the tick before
    const int since = n <= 200 ? n - 1 : n <= 230 ? 0 : n - 231;
    CHECK_NEAR(felt[n], std::min(std::max(0.04 * since, 0.0), pressed), 1e-12);
  }
}

/// What moves by itself stands still while another device waits.
void others_wait() {
  Vec3 reached[2];
  for (const int awaited : {0, 50}) {
    const auto hand = std::make_shared<HandDevice>(HandSettings{});
    const auto script = std::make_shared<ScriptedDevice>(
        std::vector<ScriptedDevice::Row>{{0.0, Vec3(0.0, 0.0, 9.0)}, {0.02, Vec3(1.0, 0.0, 9.0)}});
    for (const std::shared_ptr<Device>& simulated :
         {std::shared_ptr<Device>(hand), std::shared_ptr<Device>(script)}) {
      const auto arm = std::make_shared<TestDevice>();
      arm->what = [awaited](int n, DeviceReading& r) {
        if (n < awaited) r.status = DeviceReading::Status::waiting;
      };
      HapticLoop loop(executor(1.0, 2), {simulated, arm}, virtual_clock(simulated == hand ? 20 : 1000));
      loop.start();
      CHECK(loop.wait(20.0));
      loop.stop();
      CHECK(loop.counts().ticks == 20);
    }
    reached[awaited > 0] = hand->position();
  }
  CHECK(reached[0] == reached[1] && reached[0][2] < 3.5);
}

/// The loop hangs in a device: the force is zero before the device returns.
void stall() {
  Run run(LoopSettings{});
  std::atomic<bool> halted_meanwhile{false};
  run.device->what = [&](int n, DeviceReading&) {
    if (n != 30) return;
    for (int i = 0; i < 1000 && !run.device->halted; ++i) sleep(10);
    halted_meanwhile = run.device->halted.load();
  };
  run.to_end();
  CHECK(halted_meanwhile);
  CHECK(run.loop->failed() && run.loop->reason().find("the loop stalled: ") == 0);
}

/// A device whose start throws.
struct Unwilling : TestDevice {
  void start(double) override { throw std::invalid_argument("no power"); }
};

/// An exception from a device is passed on; earlier devices are halted and free again, and nothing hangs.
void device_that_does_not_start() {
  const auto well = std::make_shared<TestDevice>();
  HapticLoop loop(executor(1.0, 2), {well, std::make_shared<Unwilling>()}, virtual_clock(10));
  Follower follower(std::shared_ptr<HapticLoop>(&loop, [](HapticLoop*) {}));
  follower.start();
  CHECK_THROWS(loop.start(), "no power");
  CHECK(loop.started() && !loop.running() && loop.failed());
  CHECK(loop.reason() == "the loop could not be started: no power");
  CHECK(loop.wait(1.0));
  CHECK(well->halted);
  CHECK(well->claim());
  loop.stop();
  follower.stop();
  CHECK_THROWS(loop.start(), "loop must be started once");
  HapticLoop other(executor(1.0, 2), {std::make_shared<Unwilling>(), well}, virtual_clock(10));
  well->release();
  well->halted = false;
  CHECK_THROWS(other.start(), "no power");
  CHECK(!well->halted);
}

/// All devices get zero force before the first is stopped.
void zero_before_stop() {
  struct Slow : TestDevice {
    std::shared_ptr<TestDevice> other;
    bool other_was_halted = false;
    void stop() noexcept override { other_was_halted = other->halted; }
  };
  const auto first = std::make_shared<Slow>();
  const auto second = first->other = std::make_shared<TestDevice>();
  HapticLoop loop(executor(1.0, 2), {first, second}, virtual_clock(10));
  loop.start();
  CHECK(loop.wait(20.0));
  loop.stop();
  CHECK(first->other_was_halted);
}

/// A first reading that ends the session, with or without a fault.
void first_reading() {
  using Status = DeviceReading::Status;
  for (const Status status : {Status::finished, Status::lost}) {
    Run run(virtual_clock(10));
    run.device->what = [status](int, DeviceReading& reading) { reading.status = status; };
    run.to_end();
    CHECK(run.loop->counts().ticks == 0);
    CHECK(run.loop->failed() == (status == Status::lost));
    CHECK(run.device->halted && run.device->last == Vec3::Zero());
  }
}

/// A long stall limit does not make `stop` wait.
void long_stall_limit() {
  LoopSettings settings;
  settings.stall_limit = 1e6;
  Run run(settings);
  run.loop->start();
  const std::int64_t begin = steady_now();
  run.loop->stop();
  CHECK(steady_now() - begin < 20000000000);
}

}  // namespace

int main() {
  ends();
  stops();
  comes_back();
  others_wait();
  stall();
  device_that_does_not_start();
  zero_before_stop();
  first_reading();
  long_stall_limit();
  return check::report();
}
