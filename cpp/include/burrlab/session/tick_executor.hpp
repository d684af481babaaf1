// Executes tick records: force and erosion. The loop, followers, replicas and replays all execute ticks here,
// so they carve the same bone.
#pragma once

#include <atomic>
#include <memory>
#include <vector>

#include "burrlab/burr_contact.hpp"
#include "burrlab/session/tick_record.hpp"

namespace burrlab {

class AnatomyWatch;

/// A burr and the material it meets.
struct Tool {
  Burr burr;
  Material material;
};

/// The setup of a session, without the bone.
struct SessionSetup {
  std::vector<Tool> tools;  ///< one per burr, in index order
  std::uint64_t seed = 0;   ///< of the random numbers
  double period = 1.0;      ///< of the loop [ms]
  Scheme scheme = Scheme::layer;
};

class BURRLAB_API TickExecutor {
 public:
  /// `tick`: ticks executed on this bone before. Throws if a tool does not fit the bone.
  TickExecutor(std::shared_ptr<VoxelBone> bone, const SessionSetup& setup, std::uint64_t tick = 0);
  ~TickExecutor();

  /// Executes tick `record.index`, which must be `tick()`, with its k, centres and switches, and writes the
  /// results. No allocation, lock or exception. Centres must be finite and k in 1..8; the caller holds a
  /// VoxelBone::Changing if others could use the bone.
  void execute(TickRecord& record) noexcept;

  std::uint64_t tick() const { return tick_.load(std::memory_order_relaxed); }  ///< index of the next tick
  void set_tick(std::uint64_t tick);  ///< after the bone was set to another state
  /// 2 ticks, plus 1 while a tick is executed. A copy of the bone is whole if this is the same even number
  /// before and after.
  std::uint64_t version() const { return version_.load(std::memory_order_acquire); }

  /// Sets the watch, called after each burr's step; null: none. Throws if its bone or burrs are others.
  void set_watch(std::shared_ptr<AnatomyWatch> watch);
  const std::shared_ptr<AnatomyWatch>& watch() const { return watch_; }

  const std::shared_ptr<VoxelBone>& bone() const { return bone_; }
  const SessionSetup& setup() const { return setup_; }
  std::size_t burrs() const { return contacts_.size(); }
  /// The contact of a burr at a centre, without erosion.
  Contact probe(std::size_t burr, const Vec3& center) const { return contacts_[burr].probe(center); }

 private:
  std::shared_ptr<VoxelBone> bone_;
  SessionSetup setup_;
  std::vector<BurrContact> contacts_;
  std::vector<std::vector<ErosionSteps>> steps_;  // of dt = 1..8 periods, for each burr
  std::shared_ptr<AnatomyWatch> watch_;
  std::atomic<std::uint64_t> tick_, version_;
};

/// Throws unless the record can be executed: k in 1..8, this number of burrs, finite centres.
BURRLAB_API void check_record(const TickRecord& record, std::size_t burrs);

}  // namespace burrlab
