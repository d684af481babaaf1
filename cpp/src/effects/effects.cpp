#include "effects/effects.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "require.hpp"
#include "session/realtime.hpp"

namespace burrlab {

/// Finds parcels in the same cell of a grid: a hash table of cells, filled and read in the order of the
/// parcels, so that the outcome depends on nothing else.
class CellTable {
 public:
  static constexpr std::uint32_t none = 0xFFFFFFFFu;

  /// Empties the table, for cells of this edge [mm] and at most `most` entries.
  void reset(double edge, std::size_t most) {
    per_mm_ = 1.0 / edge;
    std::size_t slots = 16;
    while (slots < 2 * most) slots *= 2;
    key_.assign(slots, 0);
    value_.assign(slots, none);
  }
  /// The entry of a place's cell and a kind 0..3, to be read or set; `none` if not set.
  std::uint32_t& at(const Vec3& place, unsigned kind) {
    std::uint64_t key = 1 + kind;
    for (int axis = 0; axis < 3; ++axis) {
      const auto cell = static_cast<std::int64_t>(std::floor(place[axis] * per_mm_));
      key = key << 20 ^ (static_cast<std::uint64_t>(cell) & 0xFFFFFu);
    }
    const std::size_t mask = key_.size() - 1;
    std::size_t slot = static_cast<std::size_t>(key * 0x9E3779B97F4A7C15u >> 32) & mask;
    while (value_[slot] != none && key_[slot] != key) slot = (slot + 1) & mask;
    key_[slot] = key;
    return value_[slot];
  }

 private:
  double per_mm_ = 1.0;
  std::vector<std::uint64_t> key_;
  std::vector<std::uint32_t> value_;
};

namespace {

constexpr double longest_frame = 10.0;  // [s]
constexpr double merged_share = 0.95;   // of the limit, left by a merge at the limit
constexpr double farthest = 1e9;  // of a burr, or of the bone in voxels: beyond, half a voxel may round away
constexpr std::int32_t most_sub_steps = 64;

EffectsSetup checked(EffectsSetup setup) {
  setup.parameters.check();
  for (Vec3* direction : {&setup.down, &setup.spin}) {
    const char* name = direction == &setup.down ? "length of down" : "length of spin";
    const double length = direction->norm();
    require_positive(name, length);
    *direction /= length;
  }
  if (setup.budget) require_positive("budget", *setup.budget);
  return setup;
}

// Quanta are counted in 64 bits, and ways out of the bone are steps of half a voxel.
const VoxelBone& checked(const VoxelBone& bone) {
  const double quantum = bone.voxel_volume() / 255.0;
  if (!(quantum >= 1e-9 && quantum <= 1e3))
    refuse("volume of a voxel / 255", "from 1e-9 to 1000 mm^3", quantum);
  const double away = bone.origin().cwiseAbs().maxCoeff() / bone.spacing().minCoeff();
  if (away > farthest) refuse("distance of the bone's origin from 0", "at most 1e9 voxels", away);
  return bone;
}

// A burr's place from its device; far outside any place is as good.
BurrAt within_reach(BurrAt burr) {
  burr.center = burr.center.cwiseMax(-farthest).cwiseMin(farthest);
  return burr;
}

}  // namespace

Effects::Effects(const VoxelBone& bone, const EffectsSetup& setup)
    : setup_(checked(setup)),
      field_(checked(bone), int(setup_.parameters.solid_level)),
      motion_(field_, setup_.parameters, setup_.down, sucker_),
      sources_(setup_.parameters, setup_.down, setup_.spin, field_.quantum()),
      cells_(std::make_unique<CellTable>()) {
  if (setup_.budget) budget_.emplace(*setup_.budget);
}

Effects::~Effects() = default;

void Effects::set_nozzle(const std::optional<Nozzle>& nozzle) {
  if (nozzle) nozzle->check();
  nozzle_ = nozzle;
}

void Effects::set_sucker(const std::optional<Sucker>& sucker) {
  if (sucker) sucker->check();
  sucker_ = sucker;
}

FrameDecision Effects::step(double seconds, const BrickLevels& changes,
                            const std::vector<BurrAt>& given_burrs, const FrameDecision* given,
                            std::int64_t started) {
  if (!(seconds > 0.0 && seconds <= longest_frame)) refuse("dt_s", "above 0 and at most 10 s", seconds);
  for (std::size_t i = 0; i < changes.count; ++i)
    if (changes.bricks[i] >= field_.brick_count())
      refuse("every brick", "below " + std::to_string(field_.brick_count()), changes.bricks[i]);
  std::vector<BurrAt> burrs;
  for (const BurrAt& burr : given_burrs) {
    require_positive("radius of a burr", burr.radius);
    require_finite("center of a burr", burr.center);
    burrs.push_back(within_reach(burr));
  }
  if (given && (given->sub_steps < 1 || given->done < 1 || given->done > given->sub_steps))
    refuse("done of a decision", "from 1 to its sub_steps", given->done);
  if (given && given->sub_steps > most_sub_steps)
    refuse("sub_steps of a decision", "at most 64", given->sub_steps);
  if (given && given->merge_to < 16) refuse("merge_to of a decision", "at least 16", double(given->merge_to));
  if (started == 0) started = steady_now();
  const EffectParameters& parameters = setup_.parameters;

  EffectDraws draws(setup_.seed, frame_++);
  emissions_.clear();
  take_levels(changes, burrs, draws);
  sources_.bleed(seconds, draws, emissions_);
  if (nozzle_) sources_.irrigate(*nozzle_, seconds, burrs, burrs_, draws, emissions_);
  burrs_ = burrs;

  moving_.clear();
  for (std::size_t i = 0; i < parcels_.size(); ++i) {
    parcels_.age[i] += seconds;
    if (!motion_.rests(parcels_, i)) moving_.push_back(std::uint32_t(i));
  }
  const auto most = std::int64_t(parameters.most_parcels);
  FrameDecision decision{most, std::int32_t(parameters.sub_steps), std::int32_t(parameters.sub_steps)};
  if (given)
    decision = *given;
  else if (budget_)
    decision = budget_->plan(moving_.size(), parcels_.size(), decision.sub_steps, most);
  if (std::int64_t(parcels_.size()) > decision.merge_to) {
    ++counts_.crowded;
    merge_to(decision.merge_to);
    moving_.clear();
    for (std::size_t i = 0; i < parcels_.size(); ++i)
      if (!motion_.rests(parcels_, i)) moving_.push_back(std::uint32_t(i));
  }

  const std::int64_t before = thread_cpu_now();
  move(seconds, decision, given != nullptr, started);
  moving_time_ = double(thread_cpu_now() - before);
  moves_ = double(moving_.size()) * std::min(decision.done + 1, decision.sub_steps);
  emit(seconds);
  wet();
  parcels_.compact();
  if (std::int64_t(parcels_.size()) > most) merge_to(std::int64_t(merged_share * double(most)));

  ++counts_.frames;
  counts_.coarse += decision.sub_steps < std::int32_t(parameters.sub_steps);
  counts_.cut += decision.done < decision.sub_steps;
  const std::int64_t steps = std::min(decision.done + 1, decision.sub_steps);
  counts_.least_sub_steps = counts_.frames == 1 ? steps : std::min(counts_.least_sub_steps, steps);
  counts_.most_sub_steps = std::max(counts_.most_sub_steps, steps);
  counts_.sub_steps += steps;
  counts_.most_parcels = std::max(counts_.most_parcels, std::int64_t(parcels_.size()));
  return decision;
}

void Effects::take_levels(const BrickLevels& changes, const std::vector<BurrAt>& burrs, EffectDraws& draws) {
  bool rose = false;
  for (std::size_t i = 0; i < changes.count; ++i) {
    const BrickLoss loss = field_.exchange(changes.bricks[i], changes.density + i * brick_voxels);
    sources_.remove(field_, changes.bricks[i], loss, burrs, draws, emissions_);
    rose |= loss.rose;
  }
  if (!rose) return;
  for (std::size_t i = 0; i < parcels_.size(); ++i) {
    if (!field_.solid(parcels_.position[i])) continue;
    parcels_.position[i] = lifted(parcels_.position[i]);
    parcels_.support[i] = -1;
  }
}

// Moves a place out of the bone, against gravity: a nozzle may be in bone, and bone may come back.
Vec3 Effects::lifted(Vec3 place) const {
  const Vec3 up = -0.5 * field_.least_spacing() * setup_.down;
  while (field_.solid(place)) place += up;
  return place;
}

void Effects::move(double seconds, FrameDecision& decision, bool given, std::int64_t started) {
  if (sucker_) {
    const double more = sucker_->rate * seconds / quantum();
    room_ = std::min(room_ + more, more);  // unused room is lost, excess is owed
  }
  const double part = seconds / decision.sub_steps;
  const Motion::Interval interval = motion_.interval(part);
  std::int32_t done = 0;
  while (done < decision.done) {
    move_all(interval);
    ++done;
    if (!given && budget_ && done < decision.sub_steps - 1 && budget_->late(double(steady_now() - started)))
      decision.done = done;
  }
  if (done < decision.sub_steps) move_all(motion_.interval(part * (decision.sub_steps - done)));
}

void Effects::move_all(const Motion::Interval& interval) {
  for (const std::uint32_t i : moving_) {
    if (parcels_.support[i] >= 0 || parcels_.total(i) == 0) continue;
    const Vec3 before = parcels_.position[i];
    motion_.advance(parcels_, i, interval);
    settle(i, before);
  }
}

// Removes a parcel that met the sucker's tip on its way, or left the box.
void Effects::settle(std::size_t i, const Vec3& before) {
  const Vec3& place = parcels_.position[i];
  Quanta* account = nullptr;
  if (sucker_ && room_ > 0.0) {
    const Vec3 way = place - before, to_tip = sucker_->position - before;
    const double length = way.squaredNorm();
    const double nearest = length > 0.0 ? std::clamp(way.dot(to_tip) / length, 0.0, 1.0) : 0.0;
    if ((nearest * way - to_tip).squaredNorm() <= sucker_->radius * sucker_->radius) {
      room_ -= double(parcels_.total(i));
      account = &sucked_;
    }
  }
  const double margin = setup_.parameters.margin;
  if (!account &&
      ((place - field_.low()).minCoeff() < -margin || (field_.high() - place).minCoeff() < -margin))
    account = &drained_;
  if (!account) return;
  for (int s = 0; s < substances; ++s) (*account)[s] += parcels_.mass[i][s];
  parcels_.mass[i] = {};
}

void Effects::emit(double seconds) {
  for (const Emission& emission : emissions_) {
    for (int s = 0; s < substances; ++s) made_[s] += emission.mass[s];
    parcels_.add(lifted(emission.place), emission.velocity, emission.mass);
    const std::size_t i = parcels_.size() - 1;
    const Vec3 begin = parcels_.position[i];
    motion_.advance(parcels_, i, motion_.interval(emission.part * seconds));
    settle(i, begin);
  }
}

void Effects::count_frame(double wall_microseconds, double cpu_microseconds, int skipped) {
  wall_time_.add(wall_microseconds);
  cpu_time_.add(cpu_microseconds);
  counts_.skipped += skipped;
  if (!budget_) return;
  counts_.over_budget += 1e3 * wall_microseconds > budget_->nanoseconds();
  budget_->learn(moves_, moving_time_, double(parcels_.size()), 1e3 * cpu_microseconds - moving_time_);
}

std::array<SubstanceBalance, substances> Effects::balance() const {
  const Quanta present = parcels_.sum();
  std::array<SubstanceBalance, substances> out;
  for (int s = 0; s < substances; ++s) out[s] = {made_[s], present[s], sucked_[s], drained_[s]};
  return out;
}

void Effects::view(std::vector<ParcelView>& out) const {
  out.resize(parcels_.size());
  for (std::size_t i = 0; i < out.size(); ++i) {
    ParcelView& parcel = out[i];
    for (int axis = 0; axis < 3; ++axis) {
      parcel.position[axis] = parcels_.position[i][axis];
      parcel.velocity[axis] = parcels_.velocity[i][axis];
    }
    parcel.radius = parcels_.radius(i, quantum(), setup_.parameters);
    parcel.dust = parcels_.mass[i][dust];
    parcel.blood = parcels_.mass[i][blood];
    parcel.water = parcels_.mass[i][water];
    parcel.age = parcels_.age[i];
  }
}

// Merges dust into the liquid that wets it.
void Effects::wet() {
  const double saturation = setup_.parameters.paste_saturation;
  const auto has_room = [&](std::size_t i) {
    return double(parcels_.mass[i][dust]) < saturation * double(parcels_.liquid(i));
  };
  cells_->reset(setup_.parameters.wetting_distance, parcels_.size());
  bool any = false;
  for (std::size_t i = 0; i < parcels_.size(); ++i) {
    if (!has_room(i)) continue;
    std::uint32_t& known = cells_->at(parcels_.position[i], 0);
    if (known == CellTable::none) known = std::uint32_t(i);
    any = true;
  }
  if (!any) return;
  for (std::size_t i = 0; i < parcels_.size(); ++i) {
    if (parcels_.mass[i][dust] == 0 || !parcels_.dry(i)) continue;
    const std::uint32_t wetting = cells_->at(parcels_.position[i], 0);
    if (wetting != CellTable::none && has_room(wetting)) parcels_.merge(wetting, i);
  }
}

// Merges parcels of a kind in one cell; cells grow until few enough are left. Dry and wet stay apart, which
// leaves at most 16: eight cells meet at the origin.
void Effects::merge_to(std::int64_t most) {
  for (double edge = setup_.parameters.merge_distance; std::int64_t(parcels_.size()) > most; edge *= 2.0) {
    cells_->reset(edge, parcels_.size());
    auto left = std::int64_t(parcels_.size());
    for (std::size_t i = 0; i < parcels_.size() && left > most; ++i) {
      std::uint32_t& known = cells_->at(parcels_.position[i], parcels_.dry(i) ? 1 : 0);
      if (known == CellTable::none) {
        known = std::uint32_t(i);
        continue;
      }
      parcels_.merge(known, i);
      --left;
      ++counts_.merged;
    }
    parcels_.compact();
  }
}

}  // namespace burrlab
