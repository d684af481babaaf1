// The watch over critical structures: events, and doses of nearness, force and injury.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "burrlab/anatomy/structure_distance.hpp"
#include "burrlab/session/tick_record.hpp"

namespace burrlab {

/// Limits that cause events. Distances are those of the burr's surface.
struct WatchLimits {
  double approach = 2.0;    ///< [mm]
  double touch = 0.0;       ///< [mm]
  double injury = 0.0;      ///< volume removed from the structure above which it is injured [mm^3]
  double hysteresis = 0.5;  ///< distance beyond a limit after which its event can happen anew [mm]
};

struct WatchedStructure {
  std::shared_ptr<const StructureDistance> distance;
  WatchLimits limits;
};

enum class WatchEventKind : std::uint32_t { approach, touch, injury, away };

struct WatchEvent {
  std::uint64_t tick = 0;          ///< index of the tick of the event
  std::uint32_t kind = 0;          ///< a WatchEventKind
  std::uint32_t structure = 0;     ///< index among the watched structures
  std::int32_t burr = 0;           ///< -1: in ticks that were passed over
  std::uint32_t on = 0;            ///< the burr was turning
  double distance = 0.0;           ///< [mm]; infinite if unknown
  double force = 0.0;              ///< magnitude, of the model [N]
  std::int64_t removed = 0;        ///< from the structure so far, by all burrs [levels]
  std::array<double, 3> center{};  ///< of the burr [mm]
};

/// One burr beside one structure, since the beginning. Times are in periods of the loop, so sums are exact.
struct WatchDose {
  static constexpr std::array<double, 7> edges = {0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0};  ///< of the bins [mm]
  static constexpr std::array<double, 2> near = {1.0, 2.0};                             ///< [mm]

  double distance = std::numeric_limits<double>::infinity();  ///< now [mm]
  double closest = std::numeric_limits<double>::infinity();   ///< [mm]
  std::uint64_t closest_tick = 0;
  std::array<double, 3> closest_center{};                 ///< [mm]
  std::array<std::uint64_t, edges.size() + 1> periods{};  ///< by distance; an edge is in the bin below it
  std::array<std::uint64_t, edges.size() + 1> turning{};  ///< periods with the burr on
  std::uint64_t touching = 0;                             ///< periods with a distance of at most `touch`
  std::int64_t removed = 0;                               ///< from the structure by this burr [levels]
  std::array<std::uint64_t, near.size()> near_periods{};  ///< periods with a distance of at most `near`
  std::array<double, near.size()> near_force{};           ///< sum of force times periods, there [N]
  std::array<double, near.size()> near_peak{};            ///< largest force, there [N]
};

static_assert(sizeof(WatchEvent) == 72 && sizeof(WatchDose) == 240);

class AnatomyWatch {
 public:
  static constexpr std::size_t most_events = 10000;  ///< kept; further events are only counted
  static constexpr double largest_radius = 6.0;      ///< of a burr [mm]
  static constexpr double reach = 15.0;              ///< of the distance fields around structures [mm]

  /// Throws unless the structures are of one bone, limits are in order and radii at most 6 mm.
  AnatomyWatch(std::vector<WatchedStructure> structures, std::vector<double> radii);

  /// Begins with the bone as it is; throws unless it has the structures' tissues.
  void begin(const VoxelBone& bone, std::uint64_t tick);
  /// To be called after a burr's step. No allocation, lock or exception.
  void after_step(const VoxelBone& bone, const TickRecord& record, std::size_t burr) noexcept;
  /// The bone was set to the state before `tick` without executing the ticks until then here.
  void pass_over(const VoxelBone& bone, std::uint64_t tick) noexcept;

  const std::vector<WatchedStructure>& structures() const { return structures_; }
  std::size_t burrs() const { return radii_.size(); }
  double radius(std::size_t burr) const { return radii_[burr]; }  ///< [mm]
  const std::vector<WatchEvent>& events() const { return events_; }
  std::uint64_t events_lost() const { return events_lost_; }
  WatchDose dose(std::size_t burr, std::size_t structure) const;
  /// Removed from a structure so far, by all burrs [levels].
  std::int64_t removed(std::size_t structure) const { return begun_[structure] - levels_[structure]; }
  std::uint64_t gaps() const { return gaps_; }  ///< times ticks were passed over
  std::uint64_t ticks_passed_over() const { return ticks_passed_over_; }

 private:
  struct Beside {  // a burr beside a structure
    WatchDose dose;
    NearestVoxel nearest;
    Vec3 measured = Vec3::Zero(), center = Vec3::Zero();  // burr as last measured, and at present [mm]
    double still = 0.0;  // radius around `measured` in which no sum and no event can change [mm]
    bool approached = false, touched = false, injured = false;
  };
  std::size_t place_of(std::size_t burr, std::size_t structure) const {
    return burr * structures_.size() + structure;
  }
  void measure(std::size_t burr, std::size_t structure, const TickRecord& record) noexcept;
  bool is_injury(const VoxelBone& bone, std::size_t structure) const;
  void add_event(const WatchEvent& event) noexcept;

  std::vector<WatchedStructure> structures_;
  std::vector<double> radii_;
  std::vector<Beside> beside_;
  std::vector<std::int64_t> begun_, levels_;  // of the structures, at the beginning and now
  std::vector<WatchEvent> events_;
  std::uint64_t events_lost_ = 0, gaps_ = 0, ticks_passed_over_ = 0, next_tick_ = 0;
};

}  // namespace burrlab
