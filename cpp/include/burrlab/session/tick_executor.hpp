// Tick records turned into force and erosion: the one place where the loop, its followers, replicas and
// replays execute a tick, so that all of them carve the same bone.
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <vector>

#include "burrlab/anatomy/anatomy_watch.hpp"
#include "burrlab/burr_contact.hpp"
#include "burrlab/session/tick_record.hpp"

namespace burrlab {

/// A burr and what it meets.
struct Tool {
  Burr burr;
  Material material;
};

/// What a session is made of, besides the bone.
struct SessionSetup {
  std::vector<Tool> tools;  ///< one a burr, in index order
  std::uint64_t seed = 0;   ///< of the random numbers
  double period = 1.0;      ///< of the loop [ms]
  Scheme scheme = Scheme::layer;
};

class TickExecutor {
 public:
  /// `tick`: number of ticks executed on this bone before. Throws if a tool does not fit the bone.
  TickExecutor(std::shared_ptr<VoxelBone> bone, const SessionSetup& setup, std::uint64_t tick = 0);

  /// Executes tick `record.index`, which must be `tick()`, with its k, centres and switches; writes what the
  /// model gives. No allocation, lock or exception: the centres must be finite and k 1..8, and the caller
  /// holds a VoxelBone::Changing where others could use the bone.
  void execute(TickRecord& record) noexcept;

  std::uint64_t tick() const { return tick_.load(std::memory_order_relaxed); }  ///< index of the next tick
  void set_tick(std::uint64_t tick);  ///< after the bone was put to another state
  /// 2 ticks, plus 1 while one is executed: whoever reads it before and after copying the bone knows whether
  /// the copy is whole.
  std::uint64_t version() const { return version_.load(std::memory_order_acquire); }

  /// Called after each burr's step from now on; null: none. Throws unless it is of this bone and these burrs.
  void set_watch(std::shared_ptr<AnatomyWatch> watch);
  const std::shared_ptr<AnatomyWatch>& watch() const { return watch_; }

  const std::shared_ptr<VoxelBone>& bone() const { return bone_; }
  const SessionSetup& setup() const { return setup_; }
  std::size_t burrs() const { return contacts_.size(); }
  /// The contact of a burr at a centre now, without erosion.
  Contact probe(std::size_t burr, const Vec3& center) const { return contacts_[burr].probe(center); }

 private:
  std::shared_ptr<VoxelBone> bone_;
  SessionSetup setup_;
  std::vector<BurrContact> contacts_;
  std::vector<std::vector<ErosionSteps>> steps_;  // of dt = 1..8 periods, one a burr
  std::shared_ptr<AnatomyWatch> watch_;
  std::atomic<std::uint64_t> tick_, version_;
};

/// A record that can be executed: k 1..8, as many burrs, finite centres. Throws a sentence otherwise.
void check_record(const TickRecord& record, std::size_t burrs);

}  // namespace burrlab
