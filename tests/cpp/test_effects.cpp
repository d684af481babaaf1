// Effects frame by frame: balance of each substance, limit of parcels, equal runs, replay of decisions.
#include "burrlab/effects/effects.hpp"

#include <cstring>
#include <limits>

#include "effects_scenes.hpp"

using namespace burrlab;
using namespace scenes;

namespace {

bool same(const std::vector<ParcelView>& a, const std::vector<ParcelView>& b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof a[0]) == 0);
}

struct Run {
  VoxelBone bone = half_full();
  std::unique_ptr<Effects> effects;
  std::int64_t lost = 0;

  explicit Run(EffectsSetup setup = {}) {
    add_tissues(bone);
    effects = std::make_unique<Effects>(bone, setup);
  }
  /// Frames of 50 ms: a burr that moves down and along x, with water, and a sucker half of the time.
  void frames(int count, const std::vector<FrameDecision>* decisions = nullptr) {
    for (int i = 0; i < count; ++i) {
      const Vec3 center(6.0 + 0.05 * i, 8.0, 9.5 - 0.02 * i);
      const Cut cut(bone, center, 2.0);
      lost += cut.lost;
      effects->set_nozzle(Nozzle{Vec3(3.0, 0.0, 4.0), Vec3(-0.6, 0.0, -0.8), 150.0, 500.0, 0});
      Sucker sucker;
      sucker.position = center + Vec3(-2.0, 2.0, 1.0);
      effects->set_sucker(i / 10 % 2 ? std::optional<Sucker>(sucker) : std::nullopt);
      effects->step(0.05, cut.levels(), {cut.burr}, decisions ? &(*decisions)[std::size_t(i)] : nullptr);
      CHECK(exact(*effects));
      CHECK(effects->embedded() == 0);
      CHECK(effects->balance()[dust].made == lost);
    }
  }
};

void balance() {
  Run run;
  run.frames(60);
  const auto account = run.effects->balance();
  CHECK(account[dust].present > 0 && account[dust].sucked > 0 && account[dust].drained > 0);
  CHECK(account[blood].made > 0);
  CHECK(account[water].sucked > 0 && account[water].drained > 0);
  // 3 s of 150 mm^3/s, less the part of a quantum that has not come out yet.
  CHECK_NEAR(double(account[water].made) * run.effects->quantum(), 450.0, 1.001 * run.effects->quantum());
  const auto& removed = run.effects->sources().removed();
  CHECK(removed.size() == 2 && removed[0] + removed[1] == run.lost && removed[1] > 0);
  int paste = 0;
  for (const ParcelView& parcel : run.effects->view())
    paste += parcel.dust > 0 && parcel.blood + parcel.water > 0;
  CHECK(paste > 0);
}

void limit() {
  EffectsSetup setup;
  setup.parameters.most_parcels = 200;
  Run run(setup);
  run.frames(60);
  CHECK(run.effects->parcels().size() <= 200);
  CHECK(run.effects->counts().merged > 0 && run.effects->counts().most_parcels <= 200);
  setup.parameters.most_parcels = 16;
  Run few(setup);
  few.frames(20);
  CHECK(few.effects->parcels().size() <= 16);
}

void sameness() {
  EffectsSetup setup;
  setup.seed = 7;
  Run a(setup), b(setup);
  a.frames(30);
  b.frames(30);
  CHECK(same(a.effects->view(), b.effects->view()));
  setup.seed = 8;
  Run other(setup);
  other.frames(30);
  CHECK(!same(a.effects->view(), other.effects->view()));
}

/// A budget that is never met. Replaying the clock's decisions gives the same parcels.
void decisions() {
  EffectsSetup setup;
  setup.budget = 2e-5;
  Run hurried(setup);
  hurried.frames(60);
  const FrameCounts& counts = hurried.effects->counts();
  CHECK(counts.coarse + counts.cut > 0 && counts.crowded > 0 && counts.least_sub_steps == 1);
  setup.parameters.most_parcels = 16;  // fewer than a budget would ask for
  Run few(setup);
  few.frames(5);
  CHECK(few.effects->parcels().size() <= 16);
  setup.parameters.most_parcels = EffectParameters{}.most_parcels;
  setup.budget.reset();
  Run again(setup);
  again.frames(60, &hurried.effects->decisions());
  CHECK(same(hurried.effects->view(), again.effects->view()));
}

/// All blood of one opening is its rate times its decay time.
void blood_of_a_wound() {
  EffectsSetup setup;
  setup.parameters.blood_decay = 0.5;
  Run run(setup);
  const Cut cut(run.bone, Vec3(12.0, 8.0, 8.0), 1.5);
  run.effects->step(0.05, cut.levels(), {cut.burr});
  for (int i = 0; i < 400; ++i) run.effects->step(0.05, {}, {});
  const double opened = double(run.effects->sources().removed()[1]) * run.effects->quantum();
  const double made = double(run.effects->balance()[blood].made) * run.effects->quantum();
  CHECK_NEAR(made, 0.5 * 0.5 * opened, double(cut.bricks.size()) * 2.0 * run.effects->quantum());
  CHECK(run.effects->sources().bleeding() == 0.0);
  CHECK(exact(*run.effects));
}

/// Bone that comes back, as when a replay goes back, buries no parcel.
void refilled() {
  Run run;
  const VoxelBone whole = run.bone;
  run.frames(20);
  std::vector<std::uint32_t> bricks;
  std::vector<std::uint8_t> density;
  for (std::size_t brick = 0; brick < whole.brick_count(); ++brick) {
    bricks.push_back(std::uint32_t(brick));
    density.insert(density.end(), whole.tile(brick), whole.tile(brick) + brick_voxels);
  }
  run.effects->step(0.05, {bricks.data(), density.data(), bricks.size()}, {});
  CHECK(run.effects->refilled() == run.lost);
  CHECK(run.effects->embedded() == 0 && exact(*run.effects));
}

void merged_parcels() {
  Parcels parcels;
  parcels.add(Vec3(0.0, 0.0, 0.0), Vec3(1.0, 0.0, 0.0), {3, 0, 1});
  parcels.add(Vec3(1.0, 0.0, 0.0), Vec3(0.0, 2.0, 0.0), {0, 12, 0});
  parcels.add(Vec3(2.0, 0.0, 0.0), Vec3(0.0, 0.0, 0.0), {1, 1, 1});
  parcels.merge(0, 1);
  CHECK((parcels.mass[0] == Quanta{3, 12, 1}));
  CHECK(parcels.position[0] == Vec3(1.0, 0.0, 0.0));
  CHECK(parcels.velocity[0].isApprox(Vec3(0.25, 1.5, 0.0)));
  parcels.compact();
  CHECK(parcels.size() == 2 && parcels.position[1] == Vec3(2.0, 0.0, 0.0));
  CHECK((parcels.sum() == Quanta{4, 13, 2}));
}

void refusals() {
  Run run;
  Effects& effects = *run.effects;
  CHECK_THROWS(effects.step(0.0, {}, {}), "dt_s must be above 0");
  CHECK_THROWS(effects.step(std::numeric_limits<double>::quiet_NaN(), {}, {}), "dt_s");
  CHECK_THROWS(effects.step(0.05, {}, {{Vec3::Zero(), -1.0}}), "radius of a burr must be positive");
  const std::uint32_t beyond = 512;
  const std::vector<std::uint8_t> tile(512);
  CHECK_THROWS(effects.step(0.05, {&beyond, tile.data(), 1}, {}), "every brick must be below 512, got 512");
  const FrameDecision wrong{100, 2, 3}, small{1, 2, 2};
  CHECK_THROWS(effects.step(0.05, {}, {}, &wrong), "done of a decision");
  CHECK_THROWS(effects.step(0.05, {}, {}, &small), "merge_to of a decision");
  EffectsSetup setup;
  setup.budget = -1.0;
  CHECK_THROWS(Effects(run.bone, setup), "budget must be positive");
  setup = {};
  setup.down.setZero();
  CHECK_THROWS(Effects(run.bone, setup), "length of down must be positive");
  for (const EffectParameterRow& row : effect_parameter_table()) {
    for (const double value : {row.least - 1.0, row.most * 2.0, std::numeric_limits<double>::quiet_NaN()}) {
      EffectParameters parameters;
      parameters.*row.value = value;
      CHECK_THROWS(parameters.check(), std::string(row.name) + " must be ");
    }
    EffectParameters{}.check();
  }
  EffectParameters parts;
  parts.sub_steps = 2.5;
  CHECK_THROWS(parts.check(), "sub_steps must be a whole number from 1 to 64, got 2.5");
  Nozzle nozzle;
  nozzle.direction.setZero();
  CHECK_THROWS(effects.set_nozzle(nozzle), "length of direction of the nozzle must be positive");
  nozzle = {};
  nozzle.rate = -1.0;
  CHECK_THROWS(effects.set_nozzle(nozzle), "rate of the nozzle");
  Sucker sucker;
  sucker.reach = 0.1;
  CHECK_THROWS(effects.set_sucker(sucker), "reach of the sucker must be at least its radius");
}

}  // namespace

int main() {
  balance();
  limit();
  sameness();
  decisions();
  blood_of_a_wound();
  refilled();
  merged_parcels();
  refusals();
  return check::report();
}
