// A watch beside the tick: no allocation, even when its events are full; the last nearest voxel changes
// nothing; an executor's watch sees the same as one called by hand.
#include <cmath>
#include <limits>
#include <memory>
#include <random>

#include "anatomy/anatomy_watch.hpp"
#include "burrlab/session/tick_executor.hpp"
#include "check.hpp"
#include "count_allocations.hpp"

using namespace burrlab;

namespace {

const Material material("bone", 2.145, 0.087, Shape::parse("parabolic"), "");

/// 60^3 voxels of 0.1 mm, tissue 1 in a random tenth of a slab, tissue 2 below it.
std::shared_ptr<VoxelBone> make_bone() {
  const Index3 shape{60, 60, 60};
  auto bone = std::make_shared<VoxelBone>(shape, 255, Vec3::Constant(0.1), Vec3::Zero());
  std::vector<std::uint8_t> numbers(60 * 60 * 60);
  std::mt19937 random(3);
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    const std::size_t z = i / 3600;
    numbers[i] = z < 5 ? 2 : z < 30 && random() % 10 == 0 ? 1 : 0;
  }
  std::vector<Tissue> tissues(3);
  for (int i = 0; i < 3; ++i) {
    tissues[std::size_t(i)].name = "tissue " + std::to_string(i);
    tissues[std::size_t(i)].label = i;
    tissues[std::size_t(i)].c_e = material.c_e;
    tissues[std::size_t(i)].alpha = material.alpha;
  }
  bone->set_tissues(std::make_shared<TissueMap>(shape, numbers.data(), Tissues(tissues, material)));
  return bone;
}

std::vector<WatchedStructure> structures(const VoxelBone& bone, const WatchLimits& limits,
                                         std::int64_t along_x = 100) {
  std::vector<WatchedStructure> all;
  std::mt19937 random(9);
  std::uniform_real_distribution<double> noise(-0.4, 0.4);
  for (const std::size_t tissue : {1, 2}) {
    const StructureSearch search(bone, tissue);
    const Index3 shape{100, 100, along_x};
    const Vec3 origin = search.low() - Vec3::Constant(15.0);
    // The worst estimates, so every node is searched. Those of a box are known.
    std::vector<float> estimates(std::size_t(10000 * along_x), 0.0f);
    if (tissue == 2)
      for (std::size_t node = 0; node < estimates.size(); ++node) {
        const auto x = double(node % std::size_t(along_x)), row = double(node / std::size_t(along_x));
        const Vec3 at = origin + 0.4 * Vec3(x, std::fmod(row, 100.0), std::floor(row / 100.0));
        const Vec3 gap = (search.low() - at).cwiseMax(at - search.high()).cwiseMax(Vec3::Zero());
        estimates[node] = float(std::max(0.0, gap.norm() + noise(random)));
      }
    DistanceField field(search, shape, estimates.data(), 0.4, origin, tissue == 2 ? 0.4001 : 1e3);
    all.push_back({std::make_shared<StructureDistance>(std::move(field)), limits});
  }
  return all;
}

TickRecord record_at(std::uint64_t tick) {
  TickRecord record;
  record.index = tick;
  record.burrs = 2;
  const double t = 0.02 * double(tick);
  record.burr[0].center = {3.0 + 1.5 * std::sin(t), 3.0, 7.0 - 0.0045 * double(tick)};
  record.burr[1].center = {2.0, 3.0 + 1.2 * std::cos(t), 6.8};
  record.burr[0].on = record.burr[1].on = 1;
  return record;
}

void executor_and_watch(const WatchLimits& limits, bool full) {
  const auto bone = make_bone();
  SessionSetup setup;
  setup.tools = {{Burr{1.0}, material}, {Burr{1.5}, material}};
  setup.seed = 5;
  const std::vector<double> radii{1.0, 1.5};
  const auto all = structures(*bone, limits);
  const auto watch = std::make_shared<AnatomyWatch>(all, radii);
  TickExecutor executor(bone, setup);
  executor.set_watch(watch);
  const int ticks = full ? 12000 : 1200;
  std::vector<TickRecord> records;
  for (int i = 0; i < ticks; ++i) {
    TickRecord record = record_at(std::uint64_t(i));
    if (full) record.burr[0].center[2] = i % 2 ? 3.9 : 12.0;  // touching and away in alternate ticks
    records.push_back(record);
  }
  const long before = allocations;
  for (TickRecord& record : records) executor.execute(record);
  CHECK(allocations == before);
  CHECK(watch->events().size() + watch->events_lost() >= 4);
  if (full) {
    CHECK(watch->events().size() == AnatomyWatch::most_events);
    CHECK(watch->events_lost() > 0);
  }
  for (const WatchEvent& event : watch->events()) {
    const Vec3 center(event.center[0], event.center[1], event.center[2]);
    NearestVoxel none;
    const auto burr = std::size_t(event.burr);
    CHECK(event.distance == all[event.structure].distance->of_sphere(center, radii[burr], none));
  }
  for (std::size_t s = 0; s < 2; ++s) {
    double closest = 1e9;
    std::uint64_t periods = 0;
    for (const TickRecord& record : records) {
      const auto& c = record.burr[0].center;
      NearestVoxel none;
      closest = std::min(closest, all[s].distance->of_sphere(Vec3(c[0], c[1], c[2]), 1.0, none));
    }
    const WatchDose dose = watch->dose(0, s);
    for (const std::uint64_t n : dose.periods) periods += n;
    CHECK(dose.closest == closest);
    CHECK(periods == std::uint64_t(ticks));
    CHECK(watch->removed(s) == watch->dose(0, s).removed + watch->dose(1, s).removed);
  }
  CHECK(watch->removed(0) > 0);
}

/// A trembling hand near the structures: the doses are those of every tick's distance.
void every_tick_counts(VoxelBone& bone, const std::vector<WatchedStructure>& all, double step) {
  const WatchLimits limits = all[0].limits;
  const double radius = 1.0;
  AnatomyWatch watch(all, {radius});
  watch.begin(bone, 0);
  std::vector<WatchDose> expected(all.size());
  std::vector<std::vector<WatchEventKind>> told(all.size());
  std::vector<bool> approached(all.size()), touched(all.size()), injured(all.size());
  const std::vector<std::uint8_t> nothing(60);
  std::int64_t row = 0;
  std::mt19937 random(11);
  std::normal_distribution<double> tremble(0.0, step);
  Vec3 center(3.0, 3.0, 5.0);
  const int ticks = 20000;
  for (int tick = 0; tick < ticks; ++tick) {
    for (int axis = 0; axis < 3; ++axis) center[axis] += tremble(random);
    const double aim = 3.5 + 2.5 * std::cos(0.0025 * tick);  // into the bone and out of it
    center += 0.005 * (Vec3(3.0, 3.0, aim) - center);
    TickRecord record;
    record.index = std::uint64_t(tick);
    record.burrs = 1;
    record.k = 1 + std::uint32_t(tick % 3 == 0);
    record.burr[0].center = {center[0], center[1], center[2]};
    record.burr[0].force = {0.0, 0.3 * (tick % 7), 0.4 * (tick % 5)};
    record.burr[0].on = tick / 100 % 2;
    const double y = record.burr[0].force[1], z = record.burr[0].force[2], force = std::sqrt(y * y + z * z);
    const std::int64_t before = bone.tissue_levels(1);
    if (tick % 50 == 25) {  // from the first structure, as by another burr
      bone.write({29 - row / 60, row % 60, 0}, {1, 1, 60}, nothing.data());
      ++row;
    }
    const bool loses = bone.tissue_levels(1) < before;
    watch.after_step(bone, record, 0);
    for (std::size_t s = 0; s < all.size(); ++s) {
      NearestVoxel none;
      WatchDose& dose = expected[s];
      const double distance = dose.distance = all[s].distance->of_sphere(center, radius, none);
      if (distance < dose.closest) {
        dose.closest = distance;
        dose.closest_tick = record.index;
        dose.closest_center = record.burr[0].center;
      }
      std::size_t bin = 0;
      while (bin < WatchDose::edges.size() && distance > WatchDose::edges[bin]) ++bin;
      dose.periods[bin] += record.k;
      if (record.burr[0].on) dose.turning[bin] += record.k;
      if (distance <= limits.touch) dose.touching += record.k;
      for (std::size_t i = 0; i < WatchDose::near.size(); ++i) {
        if (distance > WatchDose::near[i]) continue;
        dose.near_periods[i] += record.k;
        dose.near_force[i] += force * record.k;
        dose.near_peak[i] = std::max(dose.near_peak[i], force);
      }
      if (!approached[s] && distance <= limits.approach) {
        approached[s] = true;
        told[s].push_back(WatchEventKind::approach);
      }
      if (!touched[s] && distance <= limits.touch) {
        touched[s] = true;
        told[s].push_back(WatchEventKind::touch);
      }
      if (loses && s == 0 && !injured[s]) {
        injured[s] = true;
        told[s].push_back(WatchEventKind::injury);
      }
      if (distance > limits.touch + limits.hysteresis) touched[s] = injured[s] = false;
      if (approached[s] && distance > limits.approach + limits.hysteresis) {
        approached[s] = false;
        told[s].push_back(WatchEventKind::away);
      }
      if (tick % 97 && tick != ticks - 1) continue;
      dose.removed = watch.removed(s);
      const WatchDose dosed = watch.dose(0, s);
      CHECK(dosed.distance == dose.distance);
      CHECK(dosed.closest == dose.closest && dosed.closest_tick == dose.closest_tick);
      CHECK(dosed.closest_center == dose.closest_center);
      CHECK(dosed.periods == dose.periods && dosed.turning == dose.turning);
      CHECK(dosed.removed == dose.removed);
      CHECK(dosed.touching == dose.touching && dosed.near_periods == dose.near_periods);
      CHECK(dosed.near_peak == dose.near_peak);
      for (std::size_t i = 0; i < WatchDose::near.size(); ++i)
        CHECK(std::abs(dosed.near_force[i] - dose.near_force[i]) < 1e-9 * (1.0 + dose.near_force[i]));
    }
  }
  std::vector<std::vector<WatchEventKind>> events(all.size());
  for (const WatchEvent& event : watch.events()) {
    events[event.structure].push_back(WatchEventKind(event.kind));
    NearestVoxel none;
    const Vec3 at(event.center[0], event.center[1], event.center[2]);
    CHECK(event.distance == all[event.structure].distance->of_sphere(at, radius, none));
  }
  CHECK(events == told);
  CHECK(told[0].size() > 10);
}

/// A distance changes by no more than `around` says.
void what_a_distance_can_become(const std::vector<WatchedStructure>& all) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> anywhere(-16.0, 22.0), share(0.0, 1.0);
  std::normal_distribution<double> direction;
  int far = 0, near = 0, outside = 0;
  for (int i = 0; i < 300000; ++i) {
    const StructureDistance& to = *all[std::size_t(i % 2)].distance;
    const double radius = i % 3 ? 1.0 : 0.3;
    const Vec3 center(anywhere(random), anywhere(random), anywhere(random));
    NearestVoxel none, other;
    const SphereDistance distance = to.around(center, radius, none);
    if (!(distance.within > 0.0)) continue;
    const bool beyond = std::isinf(distance.value);
    (beyond ? outside : distance.rate > 1.0 ? far : near) += 1;
    const Vec3 way = Vec3(direction(random), direction(random), direction(random)).normalized();
    const double moved = distance.within * std::pow(share(random), 3.0);
    const double there = to.of_sphere(center + moved * way, radius, other);
    CHECK(beyond ? std::isinf(there) : std::abs(there - distance.value) <= distance.rate * moved + 1e-9);
  }
  CHECK(near > 1000 && far > 10000 && outside > 100);
}

/// Ticks that are passed over, as when a follower copies the loop's bone: what they removed has no burr.
void an_injury_in_a_gap() {
  const auto bone = make_bone();
  const auto leader_bone = std::make_shared<VoxelBone>(*bone);
  SessionSetup setup;
  setup.tools = {{Burr{1.0}, material}};
  TickExecutor executor(bone, setup), leader(leader_bone, setup);
  const auto watch = std::make_shared<AnatomyWatch>(structures(*bone, {}), std::vector<double>{1.0});
  executor.set_watch(watch);
  for (std::uint64_t tick = 0; tick < 300; ++tick) {
    TickRecord record;
    record.index = tick;
    record.burr[0].center = {3.0, 3.0, 2.5};
    record.burr[0].on = 1;
    leader.execute(record);
  }
  watch->pass_over(*leader_bone, 300);
  CHECK(watch->gaps() == 1 && watch->ticks_passed_over() == 300);
  CHECK(watch->events().size() == 1);
  const WatchEvent& event = watch->events()[0];
  CHECK(event.tick == 299 && event.burr == -1 && std::isinf(event.distance));
  CHECK(event.kind == std::uint32_t(WatchEventKind::injury) && event.removed == watch->removed(0));
}

void refusals() {
  const auto bone = make_bone(), other = make_bone();
  const WatchLimits limits;
  auto all = structures(*bone, limits);
  CHECK_THROWS(AnatomyWatch(all, {}), "number of burrs must be 1 or 2, got 0");
  CHECK_THROWS(AnatomyWatch(all, {0.0}), "radius must be positive");
  SessionSetup setup;
  setup.tools = {{Burr{1.0}, material}};
  TickExecutor executor(bone, setup);
  CHECK_THROWS(executor.set_watch(std::make_shared<AnatomyWatch>(all, std::vector<double>{1.5})),
               "watch must be of the session's burrs");
  all.push_back(structures(*other, limits)[0]);
  CHECK_THROWS(AnatomyWatch(all, {1.0}), "structures must be of one bone");
  const StructureSearch search(*bone, 1);
  for (const double x : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    NearestVoxel nearest;
    CHECK(std::isinf(search.distance(Vec3(x, 0.0, 0.0), nearest)) && !nearest.any);
  }
}

}  // namespace

int main() {
  executor_and_watch({2.0, 0.0, 0.0, 0.5}, false);
  executor_and_watch({1.0, 0.0, 0.0, 0.1}, true);
  const auto bone = make_bone();
  const auto all = structures(*bone, {0.8, 0.1, 0.0, 0.15});
  what_a_distance_can_become(all);
  what_a_distance_can_become(structures(*bone, all[0].limits, 45));
  for (const double step : {0.0003, 0.01, 0.2})
    every_tick_counts(*std::make_unique<VoxelBone>(*bone), all, step);
  every_tick_counts(*bone, structures(*bone, all[0].limits, 45), 0.2);  // fields that end beside the burr
  an_injury_in_a_gap();
  refusals();
  return check::report();
}
