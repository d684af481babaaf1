// Motion of parcels: free fall and drag against their formulas, bone that stops them, thin walls, slopes.
#include <cmath>

#include "effects_scenes.hpp"
#include "philox.hpp"

using namespace burrlab;
using namespace scenes;

namespace {

const std::optional<Sucker> no_sucker;

struct World {
  EffectParameters parameters;
  std::optional<Sucker> sucker;
  VoxelBone bone;
  LevelField field;
  Motion motion;
  Parcels parcels;

  explicit World(VoxelBone with, const EffectParameters& p = {})
      : parameters(p),
        bone(std::move(with)),
        field(bone, int(p.solid_level)),
        motion(field, parameters, Vec3(0.0, 0.0, -1.0), sucker) {}
  void run(double seconds, int steps) {
    const auto interval = motion.interval(seconds / steps);
    for (int step = 0; step < steps; ++step)
      for (std::size_t i = 0; i < parcels.size(); ++i)
        if (!motion.rests(parcels, i)) motion.advance(parcels, i, interval);
  }
};

VoxelBone empty() { return VoxelBone({8, 8, 8}, std::uint8_t(0), Vec3::Constant(1.0), Vec3::Zero()); }

/// x = v0 t + g t^2/2 without drag; with it x = w t + (v0 - w) tau (1 - exp(-t/tau)), w = g tau.
void free_fall() {
  for (const int steps : {1, 4, 7}) {
    EffectParameters parameters;
    parameters.liquid_drag_time = 1000.0;
    World world(empty(), parameters);
    world.parcels.add(Vec3(4.0, 4.0, 4.0), Vec3(100.0, 0.0, 50.0), {0, 0, 5});
    world.parcels.add(Vec3(4.0, 4.0, 4.0), Vec3(100.0, 0.0, 50.0), {5, 0, 0});
    world.run(0.05, steps);
    const Vec3 heavy = world.parcels.position[0], light = world.parcels.position[1];
    CHECK_NEAR(heavy[0], 4.0 + 100.0 * 0.05, 2e-3);
    CHECK_NEAR(heavy[2], 4.0 + 50.0 * 0.05 - 0.5 * 9806.65 * 0.05 * 0.05, 2e-3);
    const double tau = parameters.dust_drag_time, last = -9806.65 * tau, e = std::exp(-0.05 / tau);
    CHECK_NEAR(light[0], 4.0 + 100.0 * tau * (1.0 - e), 1e-9);
    CHECK_NEAR(light[2], 4.0 + last * 0.05 + (50.0 - last) * tau * (1.0 - e), 1e-9);
    CHECK_NEAR(world.parcels.velocity[1][2], last + (50.0 - last) * e, 1e-9);
  }
}

/// A wall of one voxel stops every parcel at any speed, also where its voxels share only edges.
void no_tunnelling() {
  const int n = 40;
  VoxelBone::Levels levels(std::size_t(n * n * n), 0);
  for (int z = 0; z < n; ++z)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) levels[std::size_t((z * n + y) * n + x)] = z + x == n ? 255 : 0;
  levels[std::size_t(0)] = 0;
  EffectParameters parameters;
  parameters.gravity = 0.0;
  World world(VoxelBone({n, n, n}, levels, Vec3(0.2, 0.2, 0.3), Vec3::Zero()), parameters);
  for (std::uint32_t i = 0; i < 2000; ++i) {
    const auto r = philox4x32<philox_rounds>({i, 0, 0, 0}, 3);
    const auto part = [&](int k) { return double(r[std::size_t(k)]) * 0x1p-32; };
    world.parcels.add(Vec3(2.0 + 2.0 * part(0), 4.0 + 0.2 * part(1), 3.0 + 2.0 * part(2)),
                      Vec3(1e5, 2000.0 * (part(3) - 0.5), 1e5 * part(1)), {1, 0, 0});
  }
  world.run(0.05, 1);
  int through = 0, inside = 0;
  for (const Vec3& place : world.parcels.position) {
    const Index3 voxel = world.field.voxel_of(place);
    const bool in_wall = voxel[1] >= 0 && voxel[1] < n && voxel[0] < n && voxel[2] < n;
    inside += world.field.solid(place);
    through += in_wall && voxel[0] + voxel[2] > n;
  }
  CHECK(inside == 0);
  CHECK(through == 0);
}

/// Parcels dropped on a level surface rest on it until the voxel below is gone.
void rest() {
  World world(half_full());
  for (int i = 0; i < 20; ++i)
    world.parcels.add(Vec3(5.0 + 0.3 * i, 8.0, 10.0), Vec3(20.0 * i, 0.0, 0.0), {i % 2, 0, (i + 1) % 2});
  world.run(3.0, 300);
  for (std::size_t i = 0; i < world.parcels.size(); ++i) {
    CHECK(world.motion.rests(world.parcels, i) || world.parcels.position[i][0] > 16.0);
    if (world.parcels.position[i][0] < 16.0) CHECK_NEAR(world.parcels.position[i][2], 8.0, 1e-4);
  }
  const Cut cut(world.bone, world.parcels.position[0], 2.0);
  for (std::size_t i = 0; i < cut.bricks.size(); ++i)
    world.field.exchange(cut.bricks[i], cut.density.data() + i * brick_voxels);
  CHECK(!world.motion.rests(world.parcels, 0));
  world.run(1.0, 100);
  CHECK(world.parcels.position[0][2] < 6.5);
}

/// On a slope of 45 degrees a parcel with little friction slides and one with much friction stays.
void slope() {
  const int n = 64;
  VoxelBone::Levels levels(std::size_t(n * n * n), 0);
  for (int z = 0; z < n; ++z)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) levels[std::size_t((z * n + y) * n + x)] = z + x < n ? 255 : 0;
  EffectParameters parameters;
  parameters.dust_friction = 1.5;
  World world(VoxelBone({n, n, n}, levels, Vec3::Constant(0.2), Vec3::Constant(0.1)), parameters);
  world.parcels.add(Vec3(3.1, 6.0, 10.0), Vec3::Zero(), {1, 0, 0});
  world.parcels.add(Vec3(3.1, 6.0, 10.0), Vec3::Zero(), {0, 0, 1});
  world.run(0.2, 16);
  const Vec3 moved = world.parcels.position[1] - Vec3(3.1, 6.0, 10.0);
  CHECK((world.parcels.position[0] - Vec3(3.1, 6.0, 10.0)).norm() < 1.0);
  CHECK(moved[0] > 3.0 && moved[2] < -3.0);
  CHECK(!world.field.solid(world.parcels.position[1]));
}

/// The first hit is that of a fine walk along the segment.
void first_hits() {
  const int n = 29;
  VoxelBone::Levels levels(std::size_t(n * n * n));
  for (std::uint32_t i = 0; i < levels.size(); ++i)
    levels[i] = philox4x32<philox_rounds>({i, 1, 0, 0}, 9)[0] % 50 == 0 ? 255 : 100;
  const VoxelBone bone({n, n, n}, levels, Vec3(0.3, 0.2, 0.1), Vec3(1.0, -2.0, 3.0));
  const LevelField field(bone, 128);
  int hits = 0, wrong = 0;
  for (std::uint32_t i = 0; i < 3000; ++i) {
    const auto r = philox4x32<philox_rounds>({i, 2, 0, 0}, 9), s = philox4x32<philox_rounds>({i, 3, 0, 0}, 9);
    const Vec3 size = field.high() - field.low();
    const auto place = [&](const PhiloxBlock& b) {
      return Vec3(field.low() + size.cwiseProduct(Vec3(1.4 * b[0], 1.4 * b[1], 1.4 * b[2]) * 0x1p-32 -
                                                  Vec3::Constant(0.2)));
    };
    const Vec3 from = place(r), move = place(s) - from;
    if (field.solid(from)) continue;
    LevelHit hit;
    const bool met = field.first_hit(from, move, hit);
    hits += met;
    double part = 2.0;
    for (int k = 0; k <= 20000 && part > 1.0; ++k)
      if (field.solid(Vec3(from + (k / 20000.0) * move))) part = k / 20000.0;
    // The walk in small steps may miss a corner that the hit finds, but not the reverse.
    if (met ? hit.part > part + 1e-9 : part <= 1.0) ++wrong;
    if (met && !field.solid(hit.voxel)) ++wrong;
    if (met && (field.center(hit.voxel) - from - hit.part * move)
                       .cwiseAbs()
                       .cwiseQuotient(Vec3(0.15, 0.1, 0.05))
                       .maxCoeff() > 1.0 + 1e-9)
      ++wrong;
  }
  CHECK(hits > 300);
  CHECK(wrong == 0);
}

/// A resting parcel stays where friction holds more than the air pulls: air / tau < friction g.
void held_by_friction() {
  World world(half_full());
  world.parcels.add(Vec3(8.0, 8.0, 8.5), Vec3::Zero(), {1, 0, 0});
  world.run(1.0, 50);
  CHECK(world.motion.rests(world.parcels, 0));
  Sucker sucker;
  sucker.reach = 20.0;
  const double air = 0.6 * 9806.65 * 0.02, distance = sucker.radius * std::sqrt(sucker.pull / air);
  for (const double part : {0.99, 1.01}) {
    sucker.position = world.parcels.position[0] + Vec3(part * distance, 0.0, 0.0);
    world.sucker = sucker;
    CHECK(world.motion.rests(world.parcels, 0) == (part > 1.0));
  }
}

/// The sucker draws parcels near its tip, and none beyond its reach.
void suction() {
  VoxelBone bone = empty();
  Effects effects(bone, {});
  Sucker sucker;
  sucker.position = Vec3(4.0, 4.0, 4.0);
  CHECK_NEAR(sucker.air(Vec3(4.0, 4.0, 1.0))[2], 1500.0 * 0.25, 1e-9);
  CHECK(sucker.air(Vec3(4.0, 4.0, -5.0)).norm() == 0.0);
  sucker.rate = 10.0;
  sucker.pull = 0.0;
  effects.set_sucker(sucker);
  Nozzle nozzle{Vec3(4.0, 4.0, 4.0), Vec3(0.0, 0.0, -1.0), 1000.0, 0.0, -1};
  effects.set_nozzle(nozzle);
  for (int i = 0; i < 20; ++i) effects.step(0.05, {}, {});
  // 1 s of 10 mm^3/s. The last parcel of a frame may exceed it, and the next frame owes the excess.
  const double taken = double(effects.balance()[water].sucked) * effects.quantum();
  CHECK(taken <= 10.0 + 1.0 && taken > 9.0);
  CHECK(exact(effects));
}

}  // namespace

int main() {
  free_fall();
  no_tunnelling();
  rest();
  slope();
  first_hits();
  held_by_friction();
  suction();
  return check::report();
}
