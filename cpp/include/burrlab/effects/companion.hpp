// Effects beside a running session or a replica, in a thread of their own: the loop is not touched, what
// follows it is asked once a frame.
#pragma once

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "burrlab/copy_under.hpp"
#include "burrlab/effects/effects.hpp"
#include "burrlab/network/replica.hpp"
#include "burrlab/session/follower.hpp"

namespace burrlab {

/// What effects follow: the bone of a session, or of a replica on another machine.
struct EffectsFeed {
  std::function<std::shared_ptr<VoxelBone>(std::uint64_t& tick)> snapshot;  ///< a copy of the bone now
  std::function<BoneUpdate()> take;  ///< what changed since the feed was made, or the last call
  std::function<bool()> over;        ///< nothing comes after the next update
};

EffectsFeed feed_of(const std::shared_ptr<HapticLoop>& loop, const std::shared_ptr<Follower>& follower);
/// Throws std::invalid_argument unless the replica was started.
EffectsFeed feed_of(const std::shared_ptr<Replica>& replica);

/// What a frame left to be looked at.
struct EffectsFrame {
  std::uint64_t frame = 0;  ///< made so far
  std::uint64_t tick = 0;   ///< of the bone that it saw
  std::vector<ParcelView> parcels;
  std::array<SubstanceBalance, substances> balance{};
  std::vector<std::int64_t> removed;  ///< levels by tissue's number
  double bleeding = 0.0;              ///< [mm^3/s]
  double hidden;                      ///< part of burr 0 that is hidden; NaN without a camera
  FrameCounts counts;
};

/// What a frame was made of, so that the trace of its session makes it again.
struct FrameRecord {
  double seconds = 0.0;
  std::uint64_t tick = 0;  ///< of the bone that it saw
  FrameDecision decision;
};

class EffectsCompanion {
 public:
  static constexpr double least_rate = 1.0, most_rate = 200.0;  ///< [Hz]

  static constexpr int priority = 40;        ///< of real-time threads; the loop's is 80
  static constexpr double most_share = 0.5;  ///< of the time that frames with such a priority may take

  /// Follows a bone from where it is now. `rate` [Hz]. `realtime`: asks for a priority before
  /// ordinary threads, and below the loop's, if there is a budget and it is at most `most_share` of a period.
  EffectsCompanion(EffectsFeed feed, const EffectsSetup& setup, double rate, bool realtime);
  ~EffectsCompanion();
  EffectsCompanion(const EffectsCompanion&) = delete;
  EffectsCompanion& operator=(const EffectsCompanion&) = delete;

  void start();  ///< once
  /// After the frame that it is in; further calls do nothing.
  void stop();
  /// Until it is stopped, or a last frame after the session's end was made.
  bool running() const { return copy_under(mutex_, running_); }
  bool wait(double seconds);                                        ///< until it ends; whether it has
  std::string error() const { return copy_under(mutex_, error_); }  ///< that ended it; empty if none did
  std::vector<std::string> realtime_notes() const {
    return copy_under(mutex_, notes_);
  }  ///< what the system granted; empty before the start

  // They hold from the next frame on.
  void set_nozzle(const std::optional<Nozzle>& nozzle) { set(nozzle_, nozzle); }
  void set_sucker(const std::optional<Sucker>& sucker) { set(sucker_, sucker); }
  void set_camera(const std::optional<Camera>& camera) { set(camera_, camera); }

  EffectsFrame newest() const { return copy_under(mutex_, newest_); }  ///< a copy
  std::vector<FrameRecord> frames() const {
    return copy_under(mutex_, frames_);
  }  ///< of all frames, in order
  std::uint64_t first_tick() const { return first_tick_; }  ///< of the bone that it began with
  const Histogram& wall_time() const { return effects_->wall_time(); }
  const Histogram& cpu_time() const { return effects_->cpu_time(); }
  double quantum() const { return effects_->quantum(); }  ///< [mm^3]
  const EffectsSetup& setup() const { return effects_->setup(); }

 private:
  void run();
  void frame(int periods);
  template <class Instrument>
  void set(std::optional<Instrument>& mine, const std::optional<Instrument>& given) {
    if (given) given->check();
    const std::lock_guard<std::mutex> lock(mutex_);
    mine = given;
  }

  EffectsFeed feed_;
  double rate_;
  bool realtime_;
  std::unique_ptr<Effects> effects_;
  std::uint64_t first_tick_ = 0;
  EffectsFrame next_;      // being made
  std::mutex life_mutex_;  // of the thread; the thread itself never takes it
  std::thread thread_;
  bool started_ = false;

  mutable std::mutex mutex_;  // of all below
  std::condition_variable woken_;
  bool stopping_ = false, running_ = false;
  std::optional<Nozzle> nozzle_;
  std::optional<Sucker> sucker_;
  std::optional<Camera> camera_;
  EffectsFrame newest_;
  std::vector<FrameRecord> frames_;
  std::string error_;
  std::vector<std::string> notes_;
};

}  // namespace burrlab
