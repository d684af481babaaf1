#include "anatomy/anatomy_watch.hpp"

#include <algorithm>
#include <cmath>

#include "require.hpp"

namespace burrlab {

static void check(const std::string& name, const WatchLimits& limits, double radius) {
  require_not_negative("touch of '" + name + "'", limits.touch);
  require_not_negative("injury of '" + name + "'", limits.injury);
  require_positive("hysteresis of '" + name + "'", limits.hysteresis);
  if (!(std::isfinite(limits.approach) && limits.approach >= limits.touch))
    refuse("approach of '" + name + "'", "finite and at least touch", limits.approach);
  if (limits.approach + limits.hysteresis + radius > AnatomyWatch::reach)
    refuse("approach of '" + name + "' with hysteresis and radius", "at most 15 mm",
           limits.approach + limits.hysteresis + radius);
}

static std::size_t bin_of(double distance) {
  std::size_t bin = 0;
  while (bin < WatchDose::edges.size() && distance > WatchDose::edges[bin]) ++bin;
  return bin;
}

AnatomyWatch::AnatomyWatch(std::vector<WatchedStructure> structures, std::vector<double> radii)
    : structures_(std::move(structures)), radii_(std::move(radii)) {
  if (structures_.empty()) throw InvalidArgument("structures must be at least one, got none");
  if (radii_.empty() || radii_.size() > std::size_t(most_burrs))
    refuse("number of burrs", "1 or 2", double(radii_.size()));
  const auto map = structures_[0].distance->search().map();
  for (const double radius : radii_) {
    require_positive("radius", radius);
    if (radius > largest_radius) refuse("radius of a burr that is watched", "at most 6 mm", radius);
    for (const WatchedStructure& structure : structures_) {
      const StructureSearch& search = structure.distance->search();
      if (search.map() != map) throw InvalidArgument("structures must be of one bone");
      check(map->table()[search.tissue()].name, structure.limits, radius);
    }
  }
  beside_.resize(radii_.size() * structures_.size());
  begun_.resize(structures_.size());
  levels_.resize(structures_.size());
  events_.reserve(most_events);
}

void AnatomyWatch::begin(const VoxelBone& bone, std::uint64_t tick) {
  if (!structures_[0].distance->search().fits(bone))
    throw InvalidArgument("bone must be the one that the watch was made of, or a copy of it");
  for (std::size_t s = 0; s < structures_.size(); ++s)
    begun_[s] = levels_[s] = bone.tissue_levels(structures_[s].distance->search().tissue());
  for (Beside& beside : beside_) beside = {};
  events_.clear();
  events_lost_ = gaps_ = ticks_passed_over_ = 0;
  next_tick_ = tick;
}

void AnatomyWatch::after_step(const VoxelBone& bone, const TickRecord& record, std::size_t burr) noexcept {
  const BurrRecord& at = record.burr[burr];
  const Vec3 center(at.center[0], at.center[1], at.center[2]);
  const double force =
      std::sqrt(at.force[0] * at.force[0] + at.force[1] * at.force[1] + at.force[2] * at.force[2]);
  next_tick_ = record.index + 1;
  for (std::size_t s = 0; s < structures_.size(); ++s) {
    const WatchedStructure& structure = structures_[s];
    const WatchLimits& limits = structure.limits;
    Beside& beside = beside_[place_of(burr, s)];
    WatchDose& dose = beside.dose;
    const std::int64_t levels = bone.tissue_levels(structure.distance->search().tissue());
    const std::int64_t lost = levels_[s] - levels;
    levels_[s] = levels;
    dose.removed += lost;
    const bool injures = lost > 0 && !beside.injured && is_injury(bone, s);  // reported with its distance
    beside.center = center;
    if (injures || !((center - beside.measured).squaredNorm() < beside.still * beside.still))
      measure(burr, s, record);
    const double distance = dose.distance;
    const std::size_t bin = bin_of(distance);
    dose.periods[bin] += record.k;
    if (at.on) dose.turning[bin] += record.k;
    if (distance <= limits.touch) dose.touching += record.k;
    for (std::size_t i = 0; i < WatchDose::near.size(); ++i) {
      if (distance > WatchDose::near[i]) continue;
      dose.near_periods[i] += record.k;
      dose.near_force[i] += force * record.k;
      dose.near_peak[i] = std::max(dose.near_peak[i], force);
    }

    const auto add_event_of = [&](WatchEventKind kind) {
      add_event({record.index, std::uint32_t(kind), std::uint32_t(s), std::int32_t(burr), at.on, distance,
                 force, removed(s), at.center});
    };
    const auto enter = [&](bool& state, bool holds, WatchEventKind kind) {
      if (state || !holds) return;
      state = true;
      add_event_of(kind);
    };
    enter(beside.approached, distance <= limits.approach, WatchEventKind::approach);
    enter(beside.touched, distance <= limits.touch, WatchEventKind::touch);
    enter(beside.injured, injures, WatchEventKind::injury);
    if (distance > limits.touch + limits.hysteresis) beside.touched = beside.injured = false;
    if (beside.approached && distance > limits.approach + limits.hysteresis) {
      beside.approached = false;
      add_event_of(WatchEventKind::away);
    }
  }
}

/// Measures the distance, and how far the burr may move until it could cross a limit or an edge of the bins,
/// or be the closest so far. A search in every tick would be slow.
void AnatomyWatch::measure(std::size_t burr, std::size_t structure, const TickRecord& record) noexcept {
  const auto& [to, limits] = structures_[structure];
  Beside& beside = beside_[place_of(burr, structure)];
  WatchDose& dose = beside.dose;
  const SphereDistance distance = to->around(beside.center, radii_[burr], beside.nearest);
  dose.distance = distance.value;
  beside.measured = beside.center;
  if (distance.value < dose.closest) {
    dose.closest = distance.value;
    dose.closest_tick = record.index;
    dose.closest_center = record.burr[burr].center;
  }
  beside.still = 0.0;
  if (!(distance.within > 0.0)) return;
  double change = distance.rate * distance.within;
  if (dose.closest > -radii_[burr]) change = std::min(change, distance.value - dose.closest);
  const auto cross = [&](double limit) { change = std::min(change, std::abs(distance.value - limit)); };
  for (const double edge : WatchDose::edges) cross(edge);
  for (const double near : WatchDose::near) cross(near);
  for (const double limit : {limits.touch, limits.approach}) {
    cross(limit);
    cross(limit + limits.hysteresis);
  }
  beside.still = std::max(0.0, change - 1e-9) / distance.rate;  // more than the rounding of sums
}

/// The dose, with the distance of the burr's present place.
WatchDose AnatomyWatch::dose(std::size_t burr, std::size_t structure) const {
  const Beside& beside = beside_[place_of(burr, structure)];
  WatchDose dose = beside.dose;
  NearestVoxel nearest = beside.nearest;
  if (beside.center != beside.measured)
    dose.distance = structures_[structure].distance->of_sphere(beside.center, radii_[burr], nearest);
  return dose;
}

void AnatomyWatch::pass_over(const VoxelBone& bone, std::uint64_t tick) noexcept {
  if (tick > next_tick_) {
    ++gaps_;
    ticks_passed_over_ += tick - next_tick_;
  }
  next_tick_ = tick;
  for (std::size_t s = 0; s < structures_.size(); ++s) {
    const std::int64_t levels = bone.tissue_levels(structures_[s].distance->search().tissue());
    const std::int64_t lost = levels_[s] - levels;
    levels_[s] = levels;
    if (lost <= 0 || !is_injury(bone, s)) continue;
    add_event({tick ? tick - 1 : 0, std::uint32_t(WatchEventKind::injury), std::uint32_t(s), -1, 0,
               std::numeric_limits<double>::infinity(), 0.0, removed(s)});
  }
}

bool AnatomyWatch::is_injury(const VoxelBone& bone, std::size_t structure) const {
  return double(removed(structure)) * (bone.voxel_volume() / 255.0) > structures_[structure].limits.injury;
}

void AnatomyWatch::add_event(const WatchEvent& event) noexcept {
  if (events_.size() == most_events) {
    ++events_lost_;
    return;
  }
  events_.push_back(event);
}

}  // namespace burrlab
