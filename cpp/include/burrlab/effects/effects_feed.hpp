// What effects follow: the bone of a session, or of a replica on another machine.
#pragma once

#include <functional>
#include <memory>

#include "burrlab/network/replica.hpp"
#include "burrlab/session/follower.hpp"

namespace burrlab {

struct EffectsFeed {
  std::function<std::shared_ptr<VoxelBone>(std::uint64_t& tick)> snapshot;  ///< a copy of the bone now
  std::function<BoneUpdate()> take;  ///< what changed since the feed was made, or the last call
  std::function<bool()> over;        ///< nothing comes after the next update
};

EffectsFeed feed_of(const std::shared_ptr<HapticLoop>& loop, const std::shared_ptr<Follower>& follower);
/// Throws std::invalid_argument unless the replica was started.
EffectsFeed feed_of(const std::shared_ptr<Replica>& replica);

}  // namespace burrlab
