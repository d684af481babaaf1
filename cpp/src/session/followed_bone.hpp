// A bone that executes a session's ticks; the follower, replicas and replays have one.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "burrlab/digest.hpp"
#include "burrlab/session/tick_executor.hpp"
#include "burrlab/session/tick_record.hpp"
#include "burrlab/voxel_bone.hpp"

namespace burrlab {

/// The changes of a bone since a consumer last asked.
struct BoneUpdate {
  std::uint64_t tick = 0;  ///< ticks executed
  TickRecord newest;
  bool any = false;                   ///< there was a tick
  std::vector<std::uint32_t> bricks;  ///< changed since the last update
  std::vector<std::uint8_t> density;  ///< 512 levels each, (z, y, x)
};

/// One mark per brick. The owner of the bone must keep calls from overlapping.
class UnseenBricks {
 public:
  explicit UnseenBricks(std::size_t bricks) : marks_(bricks, 0) {}
  void mark(const std::vector<std::uint32_t>& bricks);
  /// Adds the marked bricks and their levels to `update`, and clears the marks.
  void take(const VoxelBone& bone, BoneUpdate& update);

 private:
  std::vector<std::uint8_t> marks_;
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

  /// Executes the record's tick and compares the results bit by bit.
  Difference execute(const TickRecord& record) noexcept;

  std::uint64_t tick() const { return executor_.tick(); }
  TickExecutor& executor() { return executor_; }
  const TickExecutor& executor() const { return executor_; }
  VoxelBone& bone() { return *executor_.bone(); }
  const VoxelBone& bone() const { return *executor_.bone(); }

  /// Bricks that changed since the last call, in order; updates the digest.
  std::vector<std::uint32_t> take_changed();
  const Hash128& digest();  ///< of the present bone
  /// Bricks that differ from the beginning, in order.
  std::vector<std::uint32_t> differing();
  const Hash128& initial_digest() const { return initial_.total(); }

 private:
  TickExecutor executor_;
  RunningDigest initial_, now_;
  std::vector<std::uint32_t> pending_;  // changed, but not asked for yet
};

}  // namespace burrlab
