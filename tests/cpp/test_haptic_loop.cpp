// The loop's deadlines and ends, and that it allocates nothing while it runs.
#include "burrlab/session/haptic_loop.hpp"

#include <chrono>
#include <cmath>
#include <functional>

#include "burrlab/session/follower.hpp"
#include "check.hpp"
#include "count_allocations.hpp"

using namespace burrlab;

namespace {

/// A device that does what a function says; `n` counts its readings.
struct TestDevice : Device {
  std::function<void(int n, DeviceReading&)> what = [](int, DeviceReading&) {};
  int n = 0;
  Vec3 last = Vec3::Zero();
  std::atomic<bool> halted{false};
  std::vector<std::uint64_t> periods;

  TestDevice() { periods.reserve(100000); }
  DeviceReading read(double, std::uint64_t since) noexcept override {
    DeviceReading reading;
    reading.position = Vec3(0.001 * (n % 1000), 0.0, 1.4);
    reading.on = true;
    periods.push_back(since);
    what(n++, reading);
    return reading;
  }
  void write(const Vec3& force) noexcept override { last = force; }
  void halt() noexcept override { halted = true; }
  std::string name() const override { return "test"; }
};

void sleep(int milliseconds) { std::this_thread::sleep_for(std::chrono::milliseconds(milliseconds)); }

std::shared_ptr<TickExecutor> executor(double period = 1.0, int burrs = 1) {
  const auto bone = std::make_shared<VoxelBone>(Index3{16, 64, 64}, std::uint8_t(255), Vec3::Constant(0.1),
                                                Vec3(-3.15, -3.15, -1.55));
  SessionSetup setup;
  for (int i = 0; i < burrs; ++i)
    setup.tools.push_back({Burr(1.5), Material("bone", 2.145, 0.087, Shape::parabolic(), "")});
  setup.period = period;
  return std::make_shared<TickExecutor>(bone, setup);
}

struct Run {
  std::shared_ptr<TestDevice> device = std::make_shared<TestDevice>();
  std::unique_ptr<HapticLoop> loop;

  explicit Run(const LoopSettings& settings, double period = 1.0) {
    loop = std::make_unique<HapticLoop>(executor(period), std::vector<std::shared_ptr<Device>>{device},
                                        settings);
  }
  void to_end(double seconds = 20.0) {
    loop->start();
    CHECK(loop->wait(seconds));
    loop->stop();
  }
};

LoopSettings virtual_clock(std::uint64_t ticks) {
  LoopSettings settings;
  settings.wall_clock = false;
  settings.ticks = ticks;
  return settings;
}

void no_allocation() {
  Run run(virtual_clock(5000));
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

/// A reading that takes 3.5 and 20 periods: the next tick stands for them, up to 8.
void late_ticks() {
  LoopSettings settings;
  settings.ticks = 200;
  settings.stall_limit = 5000.0;  // other work on the machine is no stall
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
    Run run(virtual_clock(1000));
    run.device->what = [](int n, DeviceReading& r) {
      if (n < 5) r.status = DeviceReading::Status::waiting;
      if (n == 35) r.status = DeviceReading::Status::finished;
    };
    run.to_end();
    CHECK(!run.loop->failed() && run.loop->counts().ticks == 30);
    CHECK(run.loop->reason() == "device 0 has come to its end");
  }
}

/// The loop hangs in a device: the force is zero before it comes back.
void stall() {
  Run run(LoopSettings{});
  std::atomic<bool> halted_meanwhile{false};
  run.device->what = [&](int n, DeviceReading&) {
    if (n != 30) return;
    for (int i = 0; i < 100 && !run.device->halted; ++i) sleep(10);
    halted_meanwhile = run.device->halted.load();
  };
  run.to_end();
  CHECK(halted_meanwhile);
  CHECK(run.loop->failed() && run.loop->reason().find("the loop stalled: ") == 0);
}

/// The follower carves the same bone, also after it was rebuilt from the running loop's.
void follower() {
  auto device = std::make_shared<TestDevice>();
  device->what = [](int n, DeviceReading& r) {
    r.position = Vec3(1.5 * std::sin(0.01 * n), std::cos(0.003 * n), 1.4 - 1e-4 * n);
  };
  LoopSettings settings;
  settings.ticks = 3000;
  settings.stall_limit = 5000.0;
  auto loop =
      std::make_shared<HapticLoop>(executor(0.5), std::vector<std::shared_ptr<Device>>{device}, settings);
  Follower follower(loop, {100, 10.0, 1.0});
  const auto view = follower.view();
  loop->start();
  follower.start();
  for (int i = 0; i < 5; ++i) {
    sleep(100);
    follower.ask_rebuild();
  }
  CHECK(loop->wait(20.0));
  follower.stop();
  CHECK(follower.status().rebuilds >= 3 && follower.status().differing == 0);
  CHECK(follower.status().tick == 3000);
  CHECK(follower.digest() == loop->executor()->bone()->digest());
  CHECK(follower.digests().back().tick == 3000 && follower.digests().back().digest == follower.digest());
  CHECK(follower.stiffness(0).stiffness > 0.1);
  const auto update = view->take();
  CHECK(update.tick == 3000 && !update.bricks.empty() && update.newest.index == 2999);
  CHECK(view->take().bricks.empty());
}

/// A device whose start throws.
struct Unwilling : TestDevice {
  void start(double) override { throw std::invalid_argument("no power"); }
};

/// What a device throws is passed on; those before it are halted and free again, and nothing hangs.
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
}

/// All devices are at zero before the first is stopped.
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

void stopped_by_many() {
  LoopSettings settings;
  settings.realtime.priority = settings.realtime.lock_memory = false;
  for (int round = 0; round < 5; ++round) {
    Run run(settings);
    run.loop->start();
    std::vector<std::thread> threads;
    for (int i = 0; i < 8; ++i) threads.emplace_back([&run, i] { run.loop->stop(i % 2 ? "" : "stopped"); });
    for (std::thread& thread : threads) thread.join();
    CHECK(run.loop->reason() == "stopped");
    CHECK(!run.loop->running());
  }
}

/// A first reading that ends the session, well or not.
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

/// A long limit of a stall does not keep `stop` waiting.
void long_stall_limit() {
  LoopSettings settings;
  settings.stall_limit = 1e6;
  Run run(settings);
  run.loop->start();
  const std::int64_t begin = steady_now();
  run.loop->stop();
  CHECK(steady_now() - begin < 20000000000);
}

/// A rebuilt follower's newest record is that of its last tick.
void newest_after_rebuild() {
  const auto loop = std::make_shared<HapticLoop>(
      executor(), std::vector<std::shared_ptr<Device>>{std::make_shared<TestDevice>()}, virtual_clock(200));
  Follower follower(loop);
  loop->start();
  CHECK(loop->wait(20.0));
  follower.ask_rebuild();
  follower.start();
  follower.stop();
  CHECK(follower.status().rebuilds == 1);
  CHECK(follower.newest().index == 199);
  CHECK(follower.digest() == loop->executor()->bone()->digest());
  CHECK_THROWS(follower.add(nullptr), "listener must be added before the follower is started");
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
  CHECK_THROWS(executor(2000.0), "alpha dt must be at most 1000");
}

}  // namespace

int main() {
  no_allocation();
  late_ticks();
  ends();
  stall();
  follower();
  device_that_does_not_start();
  zero_before_stop();
  stopped_by_many();
  first_reading();
  long_stall_limit();
  newest_after_rebuild();
  clocks();
  refusals();
  return check::report();
}
