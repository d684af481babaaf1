#include "session/followed_bone.hpp"

#include <cstring>

namespace burrlab {

FollowedBone::FollowedBone(std::shared_ptr<VoxelBone> bone, const SessionSetup& setup, std::uint64_t tick)
    : executor_(bone, setup, tick), initial_(*bone), now_(initial_), beginning_(*bone) {
  bone->take_changed();
  beginning_.skip();
}

Difference FollowedBone::execute(const TickRecord& record) noexcept {
  TickRecord executed = record;
  executor_.execute(executed);
  newest_ = record;
  for (std::size_t i = 0; i < executor_.burrs(); ++i) {
    const BurrRecord &a = record.burr[i], &b = executed.burr[i];
    if (std::memcmp(a.force.data(), b.force.data(), sizeof a.force) != 0) return {int(i), "force"};
    if (std::memcmp(&a.penetration, &b.penetration, sizeof a.penetration) != 0)
      return {int(i), "penetration"};
    if (a.removed != b.removed) return {int(i), "removed"};
  }
  return {};
}

const Hash128& FollowedBone::digest() {
  now_.update(bone(), bone().take_changed());
  return now_.total();
}

std::vector<std::uint32_t> FollowedBone::differing() {
  digest();
  std::vector<std::uint32_t> bricks;
  for (std::size_t brick = 0; brick < bone().brick_count(); ++brick)
    if (now_.brick(brick) != initial_.brick(brick)) bricks.push_back(std::uint32_t(brick));
  return bricks;
}

BoneUpdate FollowedBone::take_changed(BoneView& view) const {
  if (!view.shows(bone())) throw InvalidArgument("view must be one of this follower");
  BoneUpdate update{tick(), newest_, {}};
  view.update(update.changes);
  return update;
}

std::shared_ptr<VoxelBone> SharedBone::snapshot(std::uint64_t& tick) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  tick = shared().tick();
  return std::make_shared<VoxelBone>(bone());
}

}  // namespace burrlab
