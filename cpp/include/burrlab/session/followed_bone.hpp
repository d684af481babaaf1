// A bone of one's own that follows a session's ticks: what the follower, a replica and a replay are made of.
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

/// A bone's state since a consumer last asked.
struct BoneUpdate {
  std::uint64_t tick = 0;  ///< ticks executed
  TickRecord newest;
  bool any = false;                   ///< there was a tick
  std::vector<std::uint32_t> bricks;  ///< that changed since the last update
  std::vector<std::uint8_t> density;  ///< 512 levels each, (z, y, x)
};

/// A mark a brick. Whoever owns the bone sees to it that calls do not overlap.
class UnseenBricks {
 public:
  explicit UnseenBricks(std::size_t bricks) : marks_(bricks, 0) {}
  void mark(const std::vector<std::uint32_t>& bricks);
  /// Those marked, with their levels; none is marked any more.
  void take(const VoxelBone& bone, BoneUpdate& update);

 private:
  std::vector<std::uint8_t> marks_;
};

/// Where an executed tick differs from its record.
struct Difference {
  int burr = -1;           ///< -1: it does not
  const char* field = "";  ///< "force", "penetration" or "removed"
  explicit operator bool() const { return burr >= 0; }
};

class FollowedBone {
 public:
  /// `bone` is changed in place: give a copy.
  FollowedBone(std::shared_ptr<VoxelBone> bone, const SessionSetup& setup, std::uint64_t tick);

  /// Executes the record's tick and holds what the model gives against it, bit by bit.
  Difference execute(const TickRecord& record) noexcept;

  std::uint64_t tick() const { return executor_.tick(); }
  TickExecutor& executor() { return executor_; }
  const TickExecutor& executor() const { return executor_; }
  VoxelBone& bone() { return *executor_.bone(); }
  const VoxelBone& bone() const { return *executor_.bone(); }

  /// Bricks that changed since the last call, in order; keeps the digest up.
  std::vector<std::uint32_t> take_changed();
  const Hash128& digest();  ///< of the bone now
  /// Bricks that are not as at the beginning, in order.
  std::vector<std::uint32_t> differing();
  const Hash128& initial_digest() const { return initial_.total(); }

 private:
  TickExecutor executor_;
  RunningDigest initial_, now_;
  std::vector<std::uint32_t> pending_;  // changed, but not asked for yet
};

}  // namespace burrlab
