// Threads: each with its own bone, all reading one, or viewing one that another thread changes.
#include <algorithm>
#include <random>
#include <thread>
#include <vector>

#include "brick_levels.hpp"
#include "burrlab/bone_view.hpp"
#include "burrlab/session/haptic_loop.hpp"
#include "check.hpp"
#include "cpu_path.hpp"
#include "session/scripted_device.hpp"

using namespace burrlab;

namespace {

constexpr int workers = 4;
const Material soft("any", 2.145, 0.5, Shape::parse("power(1.5)"), "");

VoxelBone some_bone() {
  VoxelBone::Levels levels(40 * 40 * 40);
  for (std::size_t i = 0; i < levels.size(); ++i) levels[i] = static_cast<std::uint8_t>(i * i % 251);
  return VoxelBone({40, 40, 40}, levels, Vec3::Constant(0.1), Vec3::Zero());
}

BurrContact contact_on(std::shared_ptr<VoxelBone> bone, int number) {
  return BurrContact(std::move(bone), Burr(1.5), soft, std::uint64_t(number), 0,
                     number % 2 ? Scheme::cell : Scheme::layer);
}

/// Digest after a run on a copy.
std::string run(const VoxelBone& fresh, int number) {
  const auto bone = std::make_shared<VoxelBone>(fresh);
  BurrContact contact = contact_on(bone, number);
  for (int i = 0; i < 60; ++i) contact.step(Vec3(0.05 * i, 2.0, 2.5 - 0.02 * i), 1.0, true);
  return bone->digest();
}

template <class Work>
void in_threads(Work work) {
  std::vector<std::thread> threads;
  for (int number = 0; number < workers; ++number) threads.emplace_back(work, number);
  for (std::thread& thread : threads) thread.join();
}

/// A renderer's copy of a bone, by a view alone. Each call's `opened` and `filled` are what its levels show.
struct ViewedCopy {
  BoneView view;
  BoneView::Changes changes;
  Index3 shape;
  VoxelBone::Levels levels;
  std::vector<std::uint8_t> known;  // bricks that came, or were empty at first
  std::int64_t first_solid = 0;     // voxels of at least 128 when their brick first came
  std::int64_t opened = 0;          // less those filled

  explicit ViewedCopy(const VoxelBone& bone)
      : view(bone), shape(bone.shape()), levels(std::size_t(product(shape))), known(bone.brick_count()) {}

  /// Returns the number of bricks that changed; -1 if the voxels are not those whose levels crossed 128.
  int update() {
    view.update(changes);
    std::vector<Index3> below, above;
    for (std::size_t i = 0; i < changes.bricks.size(); ++i) {
      const Index3& start = changes.places[i];
      std::uint8_t& before = known[changes.bricks[i]];
      for (std::int64_t voxel = 0; voxel < brick_voxels; ++voxel) {
        const Index3 at{start[0] + voxel / 64, start[1] + voxel / 8 % 8, start[2] + voxel % 8};
        const std::uint8_t now = changes.levels[i * brick_voxels + std::size_t(voxel)];
        if (at[0] >= shape[0] || at[1] >= shape[1] || at[2] >= shape[2]) {
          if (now) return -1;
          continue;
        }
        std::uint8_t& level = levels[number_in(shape, at)];
        if (level >= 128 && now < 128) below.push_back(at);
        if (level < 128 && now >= 128 && before) above.push_back(at);
        if (now >= 128 && !before) ++first_solid;
        level = now;
      }
      before = 1;
    }
    opened += std::int64_t(below.size()) - std::int64_t(above.size());
    return below == changes.opened && above == changes.filled ? int(changes.bricks.size()) : -1;
  }
};

std::int64_t solid(const VoxelBone::Levels& levels) {
  return std::count_if(levels.begin(), levels.end(), [](auto level) { return level >= 128; });
}

/// Copies by views equal the bone after each operation, and after several.
void check_views() {
  const auto bone =
      std::make_shared<VoxelBone>(Index3{20, 41, 37}, std::uint8_t(0), Vec3::Constant(0.1), Vec3::Zero());
  std::mt19937 random(3);
  VoxelBone::Levels box(16 * 30 * 20);
  const auto write = [&](std::int64_t x) {
    for (std::uint8_t& level : box) level = static_cast<std::uint8_t>(100 + random() % 156);
    bone->write({3, 7, x}, {16, 30, 20}, box.data());
  };
  write(4);
  BurrContact contact(bone, Burr(0.6), soft, 1, 0, Scheme::layer);
  ViewedCopy often(*bone), seldom(*bone);
  for (std::size_t brick = 0; brick < bone->brick_count(); ++brick)
    often.known[brick] = bone->sums(brick).mass == 0;
  seldom.known = often.known;
  CHECK(often.update() == std::count(seldom.known.begin(), seldom.known.end(), 0));
  seldom.update();
  CHECK(often.levels == bone->density() && often.update() == 0);
  for (int i = 0; i < 60; ++i) {
    const VoxelBone before = *bone;
    for (int tick = 0; tick < 5; ++tick) contact.step(Vec3(0.6 + 0.03 * i, 1.4, 1.7), 1.0, true);
    CHECK(often.update() > 0 && often.levels == bone->density());
    const std::size_t brick = random() % bone->brick_count();
    if (i % 6 == 1) bone->restore(before.density().data());  // undone
    if (i % 6 == 2) bone->reset();
    if (i % 6 == 3) write(4 + i / 6);
    if (i % 6 == 4) bone->write_brick(brick, before.tile(brick), before.tile(brick));
    if (i % 6 == 5)
      for (std::size_t k = 0; k < bone->brick_count(); ++k) bone->copy_brick(k, before);
    CHECK(often.update() >= 0 && often.levels == bone->density());
    if (i % 7 == 6) CHECK(seldom.update() > 0 && seldom.levels == often.levels);
  }
}

/// A brick that is being written comes with the next call, and one that lost nothing does not come.
void check_unfinished_brick() {
  auto bone = std::make_unique<VoxelBone>(some_bone());
  ViewedCopy copy(*bone);
  std::uint8_t* tile = bone->open(0);
  CHECK(copy.update() == int(bone->brick_count()) - 1);
  BoneView later(*bone);
  later.skip();
  CHECK(later.shows(*bone) && !later.shows(some_bone()));
  bone->close({0, 0, 0}, 0, sum_brick(tile), nullptr);
  CHECK(copy.update() == 1 && copy.levels == bone->density());
  bone->open(0);
  bone->close({0, 0, 0}, 0, sum_brick(tile), nullptr);
  CHECK(copy.update() == 0);
  later.update(copy.changes);  // of the brick that was being written all is new
  CHECK(copy.changes.bricks == std::vector<std::uint32_t>{0} && copy.changes.opened.empty());
  const std::uint8_t empty = 0;
  bone->write({0, 1, 1}, {1, 1, 1}, &empty);
  later.update(copy.changes);
  CHECK(copy.changes.bricks.size() == 1 && copy.changes.opened.size() == 1);
  const VoxelBone::Levels last(bone->density().size(), 0);
  bone->restore(last.data());
  bone.reset();
  CHECK(copy.update() > 0 && copy.levels == last);  // the view outlives its bone
}

/// Views of different cadence in two threads while `work` changes the bone; it may call its argument to wait
/// until both have looked. No change is missed, no voxel counted twice. Under a thread sanitizer this tests
/// that there is no data race.
template <class Work>
void check_views_beside(const VoxelBone& bone, Work work) {
  std::array<std::atomic<int>, 2> calls{};
  std::array<std::atomic<bool>, 2> right{};
  std::atomic<bool> done{false};
  const auto watch = [&](std::size_t number, int pause) {
    ViewedCopy copy(bone);
    bool consistent = copy.update() > 0;
    ++calls[number];
    int changed = 0;
    while (!done) {
      const int bricks = copy.update();
      consistent = consistent && bricks >= 0;
      changed += bricks > 0;
      ++calls[number];
      std::this_thread::sleep_for(std::chrono::microseconds(pause));
    }
    consistent = consistent && copy.update() >= 0 && copy.levels == bone.density();
    right[number] =
        consistent && changed > 1 && copy.opened > 0 && copy.opened == copy.first_solid - solid(copy.levels);
  };
  std::thread fast(watch, 0, 0), slow(watch, 1, 2000);
  const auto wait = [&] {
    for (std::size_t i : {0, 1})
      for (const int until = calls[i] + 1; calls[i] < until;) std::this_thread::yield();
  };
  wait();
  work(wait);
  done = true;
  fast.join();
  slow.join();
  CHECK(right[0] && right[1]);
}

void check_views_of_a_loop() {
  const auto bone = std::make_shared<VoxelBone>(some_bone());
  SessionSetup setup;
  setup.tools.push_back({Burr(1.0), soft});
  const auto device = std::make_shared<ScriptedDevice>(
      std::vector<ScriptedDevice::Row>{{0.0, Vec3(0.5, 1.0, 3.8)}, {1.0, Vec3(3.5, 3.0, 2.5)}});
  LoopSettings settings;
  settings.stall_limit = 5000.0;
  HapticLoop loop(std::make_shared<TickExecutor>(bone, setup), {device}, settings);
  loop.start();  // the first view is made while it runs
  check_views_beside(*bone, [&](auto) { CHECK(loop.wait(60.0)); });
  loop.stop();
  CHECK(!loop.failed() && loop.counts().ticks > 100);
}

/// A brick that another thread writes all the while is seen as it was at one moment.
void check_whole_bricks() {
  VoxelBone bone({8, 8, 8}, 255, Vec3::Constant(0.1), Vec3::Zero());
  std::atomic<bool> done{false};
  std::thread writer([&] {
    for (int n = 0; n < 100000; ++n) {
      const VoxelBone::Levels levels(brick_voxels, std::uint8_t(n));
      bone.write({0, 0, 0}, {8, 8, 8}, levels.data());
    }
    done = true;
  });
  BoneView view(bone);
  BoneView::Changes changes;
  int whole = 0, mixed = 0;
  while (!done) {
    view.update(changes);
    const auto& levels = changes.levels;
    if (!levels.empty())
      ++(std::count(levels.begin(), levels.end(), levels[0]) == brick_voxels ? whole : mixed);
  }
  writer.join();
  CHECK(mixed == 0 && whole > 0);
}

}  // namespace

int main() {
  check_views();
  check_unfinished_brick();
  check_views_of_a_loop();
  check_whole_bricks();
  const VoxelBone fresh = some_bone();
  const std::string untouched = fresh.digest();
  for (const std::string& path : cpu_paths()) {
    use_cpu_path(path);
    std::vector<std::string> alone(workers), together(workers);
    for (int number = 0; number < workers; ++number) alone[std::size_t(number)] = run(fresh, number);
    in_threads([&](int number) { together[std::size_t(number)] = run(fresh, number); });
    CHECK(together == alone);
    CHECK(alone[0] != alone[1] && alone[0] != alone[2] && fresh.digest() == untouched);

    const auto shared = std::make_shared<VoxelBone>(fresh);
    const BurrContact contact = contact_on(shared, 0);
    std::vector<Vec3> forces(workers, Vec3::Zero());
    const auto probes = [&contact] {
      Vec3 sum = Vec3::Zero();
      for (int i = 0; i < 200; ++i) sum += contact.probe(Vec3(0.01 * i, 2.0, 2.5)).force;
      return sum;
    };
    in_threads([&](int number) { forces[std::size_t(number)] = probes(); });
    for (const Vec3& force : forces) CHECK(force == probes() && force.norm() > 0.0);
    CHECK(shared->digest() == untouched);

    const auto unviewed = std::make_shared<VoxelBone>(fresh);
    const auto drill = [](std::shared_ptr<VoxelBone> bone, auto wait) {
      BurrContact burr = contact_on(std::move(bone), 1);
      for (int i = 0; i < 800; ++i) {
        burr.step(Vec3(0.003 * i, 2.0, 4.8 - 0.0015 * i), 1.0, true);
        if (i % 200 == 0) wait();
      }
    };
    drill(unviewed, [] {});
    check_views_beside(*shared, [&](auto wait) { drill(shared, wait); });
    CHECK(shared->digest() == unviewed->digest());
  }
  return check::report();
}
