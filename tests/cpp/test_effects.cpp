// Blood of one wound, merged parcels, refusals; tests/python/test_effects.py has balance, limit, equal runs.
#include "effects/effects.hpp"

#include <limits>

#include "effects_scenes.hpp"

using namespace burrlab;
using namespace scenes;

namespace {

/// All blood of one opening is its rate times its decay time.
void blood_of_a_wound() {
  EffectsSetup setup;
  setup.parameters.blood_decay = 0.5;
  VoxelBone bone = half_full();
  add_tissues(bone);
  Effects effects(bone, setup);
  const Cut cut(bone, Vec3(12.0, 8.0, 8.0), 1.5);
  effects.step(0.05, cut.levels(), {cut.burr});
  for (int i = 0; i < 400; ++i) effects.step(0.05, {}, {});
  const double opened = double(effects.sources().removed()[1]) * effects.quantum();
  const double made = double(effects.balance()[blood].made) * effects.quantum();
  CHECK_NEAR(made, 0.5 * 0.5 * opened, double(cut.bricks.size()) * 2.0 * effects.quantum());
  CHECK(effects.sources().bleeding() == 0.0);
  CHECK(exact(effects));
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
  const VoxelBone bone = half_full();
  Effects effects(bone, {});
  CHECK_THROWS(effects.step(std::numeric_limits<double>::quiet_NaN(), {}, {}), "dt_s");
  const std::uint32_t beyond = 512;
  const std::vector<std::uint8_t> tile(512);
  CHECK_THROWS(effects.step(0.05, {&beyond, tile.data(), 1}, {}), "every brick must be below 512, got 512");
  const FrameDecision small{1, 2, 2};
  CHECK_THROWS(effects.step(0.05, {}, {}, &small), "merge_to of a decision");
  for (const EffectParameterRow& row : effect_parameter_table()) {
    for (const double value : {row.least - 1.0, row.most * 2.0, std::numeric_limits<double>::quiet_NaN()}) {
      EffectParameters parameters;
      parameters.*row.value = value;
      CHECK_THROWS(parameters.check(), std::string(row.name) + " must be ");
    }
    EffectParameters{}.check();
  }
}

}  // namespace

int main() {
  blood_of_a_wound();
  merged_parcels();
  refusals();
  return check::report();
}
