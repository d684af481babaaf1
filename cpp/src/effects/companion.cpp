#include "effects/companion.hpp"

#include <chrono>

#include "require.hpp"
#include "session/realtime.hpp"

namespace burrlab {

constexpr int most_frames_at_once = 4;  // periods one frame may stand for

static std::vector<BurrAt> burrs_of(const TickRecord& record) {
  std::vector<BurrAt> burrs;
  for (std::size_t i = 0; i < record.burrs && i < most_burrs; ++i) {
    const BurrRecord& burr = record.burr[i];
    burrs.push_back({Vec3(burr.center[0], burr.center[1], burr.center[2]), burr.radius});
  }
  return burrs;
}

EffectsCompanion::EffectsCompanion(EffectsFeed feed, const EffectsSetup& setup, double rate, bool realtime)
    : feed_(std::move(feed)), rate_(rate), realtime_(realtime) {
  if (!(rate >= least_rate && rate <= most_rate)) refuse("rate", "from 1 to 200 Hz", rate);
  // After the feed is made: a change between the two is then in both, and makes dust once.
  effects_ = std::make_unique<Effects>(*feed_.bone->snapshot(first_tick_), setup);
  newest_.tick = first_tick_;
}

EffectsCompanion::~EffectsCompanion() { stop(); }

void EffectsCompanion::start() {
  const std::lock_guard<std::mutex> life(life_mutex_);
  const std::lock_guard<std::mutex> lock(mutex_);
  if (started_ || stopping_)
    throw InvalidArgument("companion must be started once: it has been started or stopped");
  started_ = running_ = true;
  thread_ = std::thread([this] { run(); });
}

void EffectsCompanion::stop() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stopping_ = true;
  }
  woken_.notify_all();
  const std::lock_guard<std::mutex> life(life_mutex_);
  if (thread_.joinable()) thread_.join();
}

bool EffectsCompanion::wait(double seconds) {
  std::unique_lock<std::mutex> lock(mutex_);
  const auto limit = std::chrono::duration<double>(std::min(std::max(seconds, 0.0), 1e7));
  return woken_.wait_for(lock, limit, [this] { return !running_; });
}

void EffectsCompanion::run() {
  // Without a budget the thread could keep ordinary threads from a core.
  const auto& budget = effects_->setup().budget;
  const bool brief = budget && *budget * rate_ <= most_share;
  std::vector<std::string> notes = become_realtime({realtime_ && brief, priority, false, -1});
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    notes_ = std::move(notes);
  }
  const auto period = std::chrono::nanoseconds(std::int64_t(1e9 / rate_));
  auto deadline = std::chrono::steady_clock::now() + period;
  std::string error;
  for (bool last = false; !last;) {
    {
      std::unique_lock<std::mutex> lock(mutex_);
      if (woken_.wait_until(lock, deadline, [this] { return stopping_; })) break;
    }
    int periods = 1;
    for (deadline += period; deadline < std::chrono::steady_clock::now(); deadline += period) ++periods;
    try {
      last = feed_.over();
      frame(periods);
    } catch (const std::exception& failure) {
      error = failure.what();
      break;
    }
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  running_ = false;
  error_ = error;
  woken_.notify_all();
}

void EffectsCompanion::frame(int periods) {
  const std::int64_t started = steady_now(), cpu = thread_cpu_now();
  std::optional<Camera> camera;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    effects_->set_nozzle(nozzle_);
    effects_->set_sucker(sucker_);
    camera = camera_;
  }
  const BoneUpdate update = feed_.bone->take_changed(feed_.view);
  const BoneView::Changes& changes = update.changes;
  const std::vector<BurrAt> burrs = update.newest ? burrs_of(*update.newest) : std::vector<BurrAt>{};
  const double seconds = std::min(periods, most_frames_at_once) / rate_;
  const FrameDecision decision =
      effects_->step(seconds, {changes.bricks.data(), changes.levels.data(), changes.bricks.size()}, burrs,
                     nullptr, started);

  next_.frame = std::uint64_t(effects_->counts().frames);
  next_.tick = update.tick;
  effects_->view(next_.parcels);
  next_.balance = effects_->balance();
  next_.removed = effects_->sources().removed();
  next_.bleeding = effects_->sources().bleeding();
  next_.hidden = std::numeric_limits<double>::quiet_NaN();
  if (camera && !burrs.empty() && (camera->position - burrs[0].center).norm() > burrs[0].radius)
    next_.hidden = effects_->hidden(*camera, burrs[0]);
  effects_->count_frame(1e-3 * double(steady_now() - started), 1e-3 * double(thread_cpu_now() - cpu),
                        periods - 1);
  next_.counts = effects_->counts();
  const std::lock_guard<std::mutex> lock(mutex_);
  std::swap(newest_, next_);
  frames_.push_back({seconds, update.tick, decision});
}

EffectsFeed feed_of(const std::shared_ptr<HapticLoop>& loop, const std::shared_ptr<Follower>& follower) {
  return {follower, follower->view(), [loop, follower] {
            const bool ended = loop->started() ? !loop->running() : follower->stopped();
            return ended && follower->status().behind == 0;
          }};
}

EffectsFeed feed_of(const std::shared_ptr<Replica>& replica) {
  return {replica, replica->view(), [replica] { return replica->wait(0.0); }};
}

}  // namespace burrlab
