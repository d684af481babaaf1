// Loops and devices shared by the tests of the loop and its follower.
#pragma once

#include <chrono>
#include <functional>

#include "burrlab/session/haptic_loop.hpp"
#include "check.hpp"

namespace scenes {

using namespace burrlab;

/// A device driven by a function; `n` counts its readings.
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

inline void sleep(int milliseconds) { std::this_thread::sleep_for(std::chrono::milliseconds(milliseconds)); }

inline std::shared_ptr<TickExecutor> executor(double period = 1.0, int burrs = 1) {
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

inline LoopSettings virtual_clock(std::uint64_t ticks) {
  LoopSettings settings;
  settings.wall_clock = false;
  settings.ticks = ticks;
  return settings;
}

}  // namespace scenes
