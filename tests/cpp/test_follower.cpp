// The follower carves the loop's bone again, also after a rebuild.
#include "session/follower.hpp"

#include <cmath>

#include "cpu_path.hpp"
#include "loop_scenes.hpp"

using namespace burrlab;
using namespace scenes;

namespace {

/// The follower carves the same bone, also after a rebuild from the running loop's.
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
  BoneView view = follower.view();
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
  const auto update = follower.take_changed(view);
  CHECK(update.tick == 3000 && !update.changes.bricks.empty() && update.newest->index == 2999);
  CHECK(follower.take_changed(view).changes.bricks.empty());
}

/// Levels and tissues that differ between voxels, for copies made while a tick stores.
std::shared_ptr<VoxelBone> varied_bone(const Material& material) {
  const Index3 shape{16, 64, 64};
  VoxelBone::Levels levels(16 * 64 * 64), numbers(levels.size());
  for (std::size_t i = 0; i < levels.size(); ++i) {
    levels[i] = std::uint8_t(255 - i * i % 191);
    numbers[i] = std::uint8_t(i / 3 % 2);
  }
  const auto bone =
      std::make_shared<VoxelBone>(shape, levels, Vec3::Constant(0.1), Vec3(-3.15, -3.15, -1.55));
  const Tissues table(
      {{"soft", 1, 1.0, 0.1, {}, false, false, false}, {"hard", 2, 4.0, 0.05, {}, false, false, false}},
      material);
  bone->set_tissues(std::make_shared<TissueMap>(shape, numbers.data(), table));
  return bone;
}

/// Rebuilds again and again while ticks store into the bricks being copied, on every path of the tick. Under
/// a thread sanitizer this tests that there is no data race.
void rebuilt_all_the_while(double rate_exponent) {
  const std::string path = cpu_path();
  std::uint64_t rebuilds = 0;
  for (const std::string& name : cpu_paths()) {
    use_cpu_path(name);
    const Material material("bone", 2.145, 0.087, Shape::parabolic(), "", 1.5 - rate_exponent, rate_exponent);
    const auto bone = varied_bone(material);
    SessionSetup setup;
    setup.tools.push_back({Burr(1.0), material});
    setup.period = 0.25;
    const auto device = std::make_shared<TestDevice>();
    device->what = [](int n, DeviceReading& r) {
      r.position = Vec3(1.5 * std::sin(0.02 * n), std::cos(0.013 * n), 0.9 - 1e-4 * n);
    };
    LoopSettings settings;
    settings.ticks = 1500;
    settings.stall_limit = 5000.0;
    const auto loop = std::make_shared<HapticLoop>(std::make_shared<TickExecutor>(bone, setup),
                                                   std::vector<std::shared_ptr<Device>>{device}, settings);
    Follower follower(loop, {100, 10.0, 1.0});
    follower.start();
    loop->start();
    while (loop->running()) {
      follower.ask_rebuild();
      std::this_thread::yield();
    }
    follower.stop();
    CHECK(follower.status().differing == 0);
    rebuilds += follower.status().rebuilds;  // fewer if ticks follow each other closely
    CHECK(follower.status().tick == loop->executor()->tick());
    CHECK(follower.digest() == bone->digest());
    CHECK(bone->removed() > 0.1 && follower.bone().removed() == bone->removed());
    CHECK(follower.bone().tissue_levels(0) == bone->tissue_levels(0));
    CHECK(follower.bone().tissue_levels(1) == bone->tissue_levels(1));
  }
  CHECK(rebuilds >= 20);
  use_cpu_path(path);
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
  BoneView view = follower.view();
  CHECK(follower.take_changed(view).newest->index == 199);
  CHECK(follower.digest() == loop->executor()->bone()->digest());
  CHECK_THROWS(follower.add(nullptr), "listener must be added before the follower is started");
}

/// In a bone with tissues the stability report uses the c_e that the burr meets, not the material's: the
/// wetted area is that in a plain bone of this c_e.
void stability_with_tissues() {
  const auto area_of = [](double c_e, bool tissue) {
    const Material material("bone", tissue ? 2.145 : c_e, 0.087, Shape::parabolic(), "");
    const auto bone = std::make_shared<VoxelBone>(Index3{16, 64, 64}, std::uint8_t(255), Vec3::Constant(0.1),
                                                  Vec3(-3.15, -3.15, -1.55));
    if (tissue) {
      const Tissues table({{"hard", 3, c_e, 0.087, {}, false, false, false}}, material);
      const VoxelBone::Levels numbers(16 * 64 * 64, 0);
      bone->set_tissues(std::make_shared<TissueMap>(bone->shape(), numbers.data(), table));
    }
    SessionSetup setup;
    setup.tools.push_back({Burr(1.5), material});
    const auto device = std::make_shared<TestDevice>();
    device->what = [](int, DeviceReading& r) {
      r.position = Vec3(0.0, 0.0, 1.3);
      r.on = false;
    };
    const auto loop =
        std::make_shared<HapticLoop>(std::make_shared<TickExecutor>(bone, setup),
                                     std::vector<std::shared_ptr<Device>>{device}, virtual_clock(50));
    Follower follower(loop);
    loop->start();
    CHECK(loop->wait(20.0));
    follower.start();
    follower.stop();
    CHECK(follower.stiffness(0).c_e == c_e);
    return follower.stability(0).area;
  };
  CHECK(area_of(4.0, true) == area_of(4.0, false) && area_of(4.0, true) > 1.0);
}

}  // namespace

int main() {
  stability_with_tissues();
  follower();
  rebuilt_all_the_while(0.0);
  rebuilt_all_the_while(0.25);
  newest_after_rebuild();
  return check::report();
}
