// Effects in a thread beside a loop and its follower: rebuilds, changing instruments, the end.
#include "effects/companion.hpp"

#include <cmath>

#include "loop_scenes.hpp"

using namespace burrlab;
using namespace scenes;

namespace {

struct Beside {
  std::shared_ptr<TestDevice> device = std::make_shared<TestDevice>();
  std::shared_ptr<HapticLoop> loop;
  std::shared_ptr<Follower> follower;
  std::unique_ptr<EffectsCompanion> companion;

  explicit Beside(std::uint64_t ticks) {
    device->what = [](int n, DeviceReading& r) {
      r.position = Vec3(1.5 * std::sin(0.01 * n), std::cos(0.003 * n), 1.4 - 1e-4 * n);
    };
    LoopSettings settings;
    settings.ticks = ticks;
    settings.stall_limit = 5000.0;
    loop =
        std::make_shared<HapticLoop>(executor(0.5), std::vector<std::shared_ptr<Device>>{device}, settings);
    follower = std::make_shared<Follower>(loop, FollowerSettings{100, 10.0, 1.0});
    EffectsSetup setup;
    setup.budget = 0.005;
    companion = std::make_unique<EffectsCompanion>(feed_of(loop, follower), setup, 50.0, true);
  }
  void start() {
    companion->start();
    loop->start();
    follower->start();
  }
  std::int64_t removed() const {
    const VoxelBone& bone = *loop->executor()->bone();
    return std::llround(bone.removed() / companion->quantum());
  }
};

bool exact(const EffectsFrame& frame) {
  bool all = true;
  for (const SubstanceBalance& balance : frame.balance) all &= balance.exact();
  return all;
}

/// All removed bone is dust, although the follower was rebuilt while other threads changed and read.
void to_the_end() {
  Beside beside(2000);
  EffectsCompanion& companion = *beside.companion;
  CHECK(!companion.running() && companion.frames().empty() && std::isnan(companion.newest().hidden));
  beside.start();
  for (int i = 0; i < 8; ++i) {
    sleep(100);
    beside.follower->ask_rebuild();
    Nozzle nozzle;
    nozzle.rate = 50.0 * i;
    companion.set_nozzle(nozzle);
    Sucker sucker;
    sucker.position = Vec3(0.1 * i, 0.0, 1.0);
    companion.set_sucker(sucker);
    companion.set_camera(Camera{});
    CHECK(exact(companion.newest()));
  }
  CHECK(beside.loop->wait(20.0));
  beside.follower->stop();
  CHECK(companion.wait(20.0) && companion.error().empty());
  const EffectsFrame last = companion.newest();
  const std::uint64_t ticks = beside.loop->executor()->tick();
  CHECK(last.tick == ticks && ticks > 100 && exact(last));
  CHECK(last.balance[dust].made == beside.removed() && beside.removed() > 0);
  CHECK(last.balance[water].made > 0 && last.hidden >= 0.0);
  CHECK(last.frame == companion.frames().size() && companion.frames().back().tick == ticks);
  CHECK(beside.follower->status().rebuilds >= 3);
#ifdef __linux__
  CHECK(companion.realtime_notes().size() == 2);
#else
  CHECK(companion.realtime_notes().size() == 1);  // real time is not available
#endif
}

}  // namespace

int main() {
  to_the_end();
  return check::report();
}
