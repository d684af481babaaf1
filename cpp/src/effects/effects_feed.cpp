#include "burrlab/effects/effects_feed.hpp"

namespace burrlab {

EffectsFeed feed_of(const std::shared_ptr<HapticLoop>& loop, const std::shared_ptr<Follower>& follower) {
  return {[follower](std::uint64_t& tick) { return follower->snapshot(tick); },
          [follower, view = follower->view()] { return view->take(); },
          [loop, follower] {
            const bool ended = loop->started() ? !loop->running() : follower->stopped();
            return ended && follower->status().behind == 0;
          }};
}

EffectsFeed feed_of(const std::shared_ptr<Replica>& replica) {
  return {[replica](std::uint64_t& tick) { return replica->snapshot(tick); },
          [replica, unseen = replica->unseen()] { return replica->take_changed(*unseen); },
          [replica] { return replica->wait(0.0); }};
}

}  // namespace burrlab
