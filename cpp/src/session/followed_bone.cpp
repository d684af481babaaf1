#include "session/followed_bone.hpp"

#include <algorithm>
#include <cstring>
#include <iterator>

namespace burrlab {

FollowedBone::FollowedBone(std::shared_ptr<VoxelBone> bone, const SessionSetup& setup, std::uint64_t tick)
    : executor_(bone, setup, tick), initial_(*bone), now_(initial_) {
  bone->take_changed();
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
  const std::vector<std::uint32_t> changed = bone().take_changed();
  now_.update(bone(), changed);
  std::vector<std::uint32_t> all;
  std::set_union(pending_.begin(), pending_.end(), changed.begin(), changed.end(), std::back_inserter(all));
  pending_.swap(all);
  return now_.total();
}

std::vector<std::uint32_t> FollowedBone::differing() {
  digest();
  std::vector<std::uint32_t> bricks;
  for (std::size_t brick = 0; brick < bone().brick_count(); ++brick)
    if (now_.brick(brick) != initial_.brick(brick)) bricks.push_back(std::uint32_t(brick));
  return bricks;
}

std::shared_ptr<UnseenBricks> FollowedBone::view() {
  auto view = std::make_shared<UnseenBricks>(bone().brick_count());
  view->mark(differing());
  views_.erase(std::remove_if(views_.begin(), views_.end(), [](const auto& v) { return v.expired(); }),
               views_.end());
  views_.push_back(view);
  return view;
}

BoneUpdate FollowedBone::take_changed(UnseenBricks& view) {
  digest();
  bool known = false;
  for (const auto& weak : views_) {
    const auto each = weak.lock();
    if (each) each->mark(pending_);
    known |= each.get() == &view;
  }
  pending_.clear();
  if (!known) throw InvalidArgument("view must be one of this follower");
  BoneUpdate update{tick(), newest_, {}, {}};
  view.take(bone(), update);
  return update;
}

void SharedBone::visit(const std::function<void(FollowedBone&)>& function) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  function(shared());
}

std::shared_ptr<VoxelBone> SharedBone::snapshot(std::uint64_t& tick) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  tick = shared().tick();
  return std::make_shared<VoxelBone>(bone());
}

std::string SharedBone::digest() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return shared().digest().text();
}

std::shared_ptr<UnseenBricks> SharedBone::view() {
  const std::lock_guard<std::mutex> lock(mutex_);
  return shared().view();
}

BoneUpdate SharedBone::take_changed(UnseenBricks& view) {
  const std::lock_guard<std::mutex> lock(mutex_);
  return shared().take_changed(view);
}

void UnseenBricks::mark(const std::vector<std::uint32_t>& bricks) {
  for (const std::uint32_t brick : bricks) marks_[brick] = 1;
}

void UnseenBricks::take(const VoxelBone& bone, BoneUpdate& update) {
  for (std::size_t brick = 0; brick < marks_.size(); ++brick) {
    if (!marks_[brick]) continue;
    marks_[brick] = 0;
    update.bricks.push_back(std::uint32_t(brick));
    update.density.insert(update.density.end(), bone.tile(brick), bone.tile(brick) + brick_voxels);
  }
}

}  // namespace burrlab
