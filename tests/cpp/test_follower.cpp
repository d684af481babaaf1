// The follower carves the loop's bone again, also after it was rebuilt.
#include "burrlab/session/follower.hpp"

#include <cmath>

#include "loop_scenes.hpp"

using namespace burrlab;
using namespace scenes;

namespace {

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

}  // namespace

int main() {
  follower();
  newest_after_rebuild();
  return check::report();
}
