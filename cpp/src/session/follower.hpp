// The follower of a loop: executes the loop's ticks on its own bone, for all that need to see the bone. The
// loop serves nobody.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "burrlab/session/haptic_loop.hpp"
#include "session/contact_stiffness.hpp"
#include "session/followed_bone.hpp"

namespace burrlab {

/// Called in the follower's thread, between ticks.
class TickListener {
 public:
  virtual ~TickListener() = default;
  virtual void on_tick(const TickRecord& record) = 0;
  /// Digest of the bone before tick `tick`.
  virtual void on_digest(std::uint64_t tick, const Hash128& digest) = 0;
  /// The ticks up to `tick` were passed over: the bone was copied from the loop's.
  virtual void on_rebuild(std::uint64_t tick) = 0;
  /// After each batch of ticks, with the bone.
  virtual void on_bone(FollowedBone& bone) = 0;
  /// After the loop's last tick.
  virtual void on_end() = 0;
};

struct FollowerSettings {
  std::uint64_t digest_every = 1000;  ///< ticks
  double stiffness_every = 50.0;      ///< [ms]
  double rebuild_after = 1.0;         ///< it is rebuilt when this far behind [s]
};

struct DigestAt {
  std::uint64_t tick;  ///< ticks executed
  std::string digest;
};

/// Contact stiffness of a burr at its present place, dF/dH along the normal.
struct StiffnessAt {
  std::uint64_t tick = 0;
  double stiffness = 0.0;  ///< k [N/mm]; 0 without contact
  double stiffest = 0.0;   ///< in any direction: in a tunnel the walls can be stiffer [N/mm]
  double force = 0.0;      ///< [N]
  double age = 0.0;        ///< of the position [ms]
  double c_e = 0.0;        ///< of the contact; 0 before the first one [N/mm^2]
};

struct FollowerStatus {
  std::uint64_t tick = 0;    ///< ticks executed
  std::uint64_t behind = 0;  ///< ticks the loop is ahead
  double most_behind = 0.0;  ///< so far [s]
  std::uint64_t rebuilds = 0;
  std::uint64_t differing = 0;  ///< ticks whose results differ from the loop's: 0 unless the machine errs
  std::string first_difference;
};

class Follower : public SharedBone {
 public:
  /// Copies the loop's bone; to be called before the loop starts.
  Follower(std::shared_ptr<HapticLoop> loop, const FollowerSettings& settings = {});
  ~Follower();  ///< does not wait for the loop's end

  void add(std::shared_ptr<TickListener> listener);  ///< before `start`; throws after it
  void start();
  void stop();                                       ///< first executes what is left in the ring
  bool stopped() const { return stopping_.load(); }  ///< or about to be

  FollowerStatus status() const;
  std::vector<DigestAt> digests(std::size_t from = 0) const;  ///< all but the first `from`
  StiffnessAt stiffness(std::size_t burr) const;
  /// The stiffness against the limits of the burr's device. Ratio and warning are of the stiffest direction.
  StabilityReport stability(std::size_t burr) const;
  /// Rebuilds at the next turn, as if too far behind. For tests.
  void ask_rebuild() { rebuild_asked_.store(true); }

 private:
  FollowedBone& shared() const override { return bone_; }
  void run();
  bool execute_batch();  // one batch; whether there was anything to do
  void execute(const TickRecord& record);
  void rebuild();
  void measure_stiffness();

  std::shared_ptr<HapticLoop> loop_;
  FollowerSettings settings_;
  std::shared_ptr<RecordReader> reader_;
  std::vector<std::shared_ptr<TickListener>> listeners_;
  std::mutex life_mutex_;  // of the thread, which never takes it
  std::thread thread_;
  std::atomic<bool> started_{false}, stopping_{false}, abandoned_{false}, rebuild_asked_{false};

  // Under the bone's mutex, which the loop never takes:
  mutable FollowedBone bone_;
  FollowerStatus status_;
  std::vector<DigestAt> digests_;
  std::array<StiffnessAt, most_burrs> stiffness_;
  std::int64_t last_stiffness_ = 0;
};

}  // namespace burrlab
