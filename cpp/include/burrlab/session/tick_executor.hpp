// Executes tick records: force and erosion. The loop, followers, replicas and replays all execute ticks here,
// so they carve the same bone.
//
//     burrlab::SessionSetup setup;
//     setup.tools = {{burrlab::Burr(3.0), burrlab::paper_material("bone")}};
//     burrlab::TickExecutor executor(bone, setup);
//     burrlab::TickRecord record;
//     record.burr[0].center = {0.0, 0.0, 2.7};  // [mm]
//     record.burr[0].on = 1;
//     executor.execute(record);  // record.burr[0].force [N]
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
  Burr burr;          ///< its radius
  Material material;  ///< of a bone without tissues
};

/// The setup of a session, without the bone.
struct SessionSetup {
  std::vector<Tool> tools;        ///< one per burr, in index order
  std::uint64_t seed = 0;         ///< of the random numbers
  double period = 1.0;            ///< of the loop [ms]
  Scheme scheme = Scheme::layer;  ///< of the voxels
};

/// The ticks of a session; one thread executes them.
class BURRLAB_API TickExecutor {
 public:
  /// `tick`: ticks executed on this bone before. The bone has its tissues by now, and keeps them. Throws
  /// InvalidArgument if a tool does not fit the bone, alpha dt of 8 periods is above 1000, or there are not
  /// 1 or 2 tools.
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

  /// @cond watch
  /// Sets the watch, called after each burr's step; null: none. Throws if its bone or burrs are others.
  void set_watch(std::shared_ptr<AnatomyWatch> watch);
  const std::shared_ptr<AnatomyWatch>& watch() const { return watch_; }
  /// @endcond

  const std::shared_ptr<VoxelBone>& bone() const { return bone_; }  ///< that the burrs cut
  const SessionSetup& setup() const { return setup_; }              ///< as it was set
  std::size_t burrs() const { return contacts_.size(); }            ///< one per tool
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

/// Throws InvalidArgument unless the record can be executed: k in 1..8, this number of burrs, finite centres.
BURRLAB_API void check_record(const TickRecord& record, std::size_t burrs);

}  // namespace burrlab
