// Effects beside a running session or replica, in their own thread. They ask the follower or the replica once
// a frame; the loop is not touched.
#pragma once

#include <condition_variable>
#include <functional>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "copy_under.hpp"
#include "effects/effects.hpp"
#include "network/replica.hpp"
#include "session/follower.hpp"

namespace burrlab {

/// The bone that effects follow: that of a session, or of a replica.
struct EffectsFeed {
  std::shared_ptr<SharedBone> bone;
  BoneView view;
  std::function<bool()> over;  ///< true if no more comes after the next update
};

EffectsFeed feed_of(const std::shared_ptr<HapticLoop>& loop, const std::shared_ptr<Follower>& follower);
/// Throws InvalidArgument unless the replica was started.
EffectsFeed feed_of(const std::shared_ptr<Replica>& replica);

/// What a frame shows.
struct EffectsFrame {
  std::uint64_t frame = 0;  ///< frames made so far
  std::uint64_t tick = 0;   ///< of the bone in the frame
  std::vector<ParcelView> parcels;
  std::array<SubstanceBalance, substances> balance{};
  std::vector<std::int64_t> removed;                         ///< levels, by tissue number
  double bleeding = 0.0;                                     ///< [mm^3/s]
  double hidden = std::numeric_limits<double>::quiet_NaN();  ///< part of burr 0; NaN without a camera
  FrameCounts counts;
};

/// What a frame was made of; with the session's trace, it can be made again.
struct FrameRecord {
  double seconds = 0.0;
  std::uint64_t tick = 0;  ///< of the bone in the frame
  FrameDecision decision;
};

class EffectsCompanion {
 public:
  static constexpr double least_rate = 1.0, most_rate = 200.0;  ///< [Hz]

  static constexpr int priority = 40;        ///< of real-time threads; the haptic loop has 80
  static constexpr double most_share = 0.5;  ///< of a period that a real-time frame's budget may take

  /// Follows a bone from its present state. `rate` [Hz]. `realtime` asks for a priority above ordinary
  /// threads and below the haptic loop. It needs a budget of at most `most_share` of a period.
  EffectsCompanion(EffectsFeed feed, const EffectsSetup& setup, double rate, bool realtime);
  ~EffectsCompanion();

  void start();  ///< once
  /// Stops after the frame that is under way; further calls do nothing.
  void stop();
  /// True until `stop`, or until the last frame after the session's end.
  bool running() const { return copy_under(mutex_, running_); }
  bool wait(double seconds);                                        ///< waits; returns whether it ended
  std::string error() const { return copy_under(mutex_, error_); }  ///< the failure that ended it, or empty
  /// What the system granted; empty before the start.
  std::vector<std::string> realtime_notes() const { return copy_under(mutex_, notes_); }

  // These take effect with the next frame.
  void set_nozzle(const std::optional<Nozzle>& nozzle) { set(nozzle_, nozzle); }
  void set_sucker(const std::optional<Sucker>& sucker) { set(sucker_, sucker); }
  void set_camera(const std::optional<Camera>& camera) { set(camera_, camera); }

  EffectsFrame newest() const { return copy_under(mutex_, newest_); }  ///< a copy
  /// All frames, in order.
  std::vector<FrameRecord> frames() const { return copy_under(mutex_, frames_); }
  std::uint64_t first_tick() const { return first_tick_; }  ///< of the bone at the beginning
  const Histogram& wall_time() const { return effects_->wall_time(); }
  const Histogram& cpu_time() const { return effects_->cpu_time(); }
  double quantum() const { return effects_->quantum(); }  ///< [mm^3]

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
  EffectsFrame next_;      // the frame being made
  std::mutex life_mutex_;  // of the thread, which never takes it
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
