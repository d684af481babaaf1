// A bone that executes a session's ticks; the follower, replicas and replays have one.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "burrlab/bone_view.hpp"
#include "burrlab/digest.hpp"
#include "burrlab/session/tick_executor.hpp"
#include "burrlab/session/tick_record.hpp"
#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// The changes of a bone since a consumer last asked.
struct BoneUpdate {
  std::uint64_t tick = 0;            ///< ticks executed
  std::optional<TickRecord> newest;  ///< none before the first tick
  BoneView::Changes changes;         ///< since the last update
};

/// The first difference between an executed tick and its record.
struct Difference {
  int burr = -1;           ///< -1: none
  const char* field = "";  ///< "force", "penetration" or "removed"
  explicit operator bool() const { return burr >= 0; }
};

class FollowedBone {
 public:
  /// Changes `bone` in place: give a copy.
  FollowedBone(std::shared_ptr<VoxelBone> bone, const SessionSetup& setup, std::uint64_t tick);

  /// Executes the record's tick, which is then the newest, and compares the results bit by bit.
  Difference execute(const TickRecord& record) noexcept;

  std::uint64_t tick() const { return executor_.tick(); }
  const std::optional<TickRecord>& newest() const { return newest_; }  ///< record of the last tick executed
  void set_newest(const TickRecord& record) { newest_ = record; }      ///< after ticks were passed over
  TickExecutor& executor() { return executor_; }
  const TickExecutor& executor() const { return executor_; }
  VoxelBone& bone() { return *executor_.bone(); }
  const VoxelBone& bone() const { return *executor_.bone(); }

  const Hash128& digest();  ///< of the present bone
  /// Bricks that differ from the beginning, in order.
  std::vector<std::uint32_t> differing();
  const Hash128& initial_digest() const { return initial_.total(); }

  /// For a new consumer: a view that has seen the bone of the beginning, and nothing since.
  BoneView view() const { return beginning_; }
  /// The changes since the view was last taken; throws InvalidArgument if it is not of this bone.
  BoneUpdate take_changed(BoneView& view) const;

 private:
  TickExecutor executor_;
  RunningDigest initial_, now_;
  BoneView beginning_;
  std::optional<TickRecord> newest_;
};

/// A bone that a thread of the derived class changes tick by tick. Others use it between two ticks.
class SharedBone {
 public:
  /// Calls `function` with the bone, and returns what it returns; no tick is executed meanwhile.
  template <class Function>
  auto visit(Function&& function) const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return function(shared());
  }
  /// A copy of the bone, and the number of ticks executed on it.
  std::shared_ptr<VoxelBone> snapshot(std::uint64_t& tick) const;
  /// Of the present bone.
  std::string digest() const {
    return visit([](FollowedBone& bone) { return bone.digest().text(); });
  }
  /// As `FollowedBone::view`, and as `FollowedBone::take_changed`.
  BoneView view() const {
    return visit([](FollowedBone& bone) { return bone.view(); });
  }
  BoneUpdate take_changed(BoneView& view) const {
    return visit([&](FollowedBone& bone) { return bone.take_changed(view); });
  }
  const VoxelBone& bone() const { return shared().bone(); }  ///< for its constant properties, as its shape

 protected:
  ~SharedBone() = default;
  virtual FollowedBone& shared() const = 0;

  mutable std::mutex mutex_;  // of the bone, and of all that goes with it
};

}  // namespace burrlab
