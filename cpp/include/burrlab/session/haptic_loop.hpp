// The haptic loop: a thread that reads the devices, executes a tick and sends the force, at fixed deadlines.
//
//     burrlab::HapticLoop loop(executor, {std::make_shared<Arm>()}, {});
//     loop.start();
//     loop.wait(10.0);  // [s]
//     loop.stop();
//     std::printf("%s; a tick took %g us at most\n", loop.reason().c_str(), loop.wall_time().largest());
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "burrlab/session/device.hpp"
#include "burrlab/session/histogram.hpp"
#include "burrlab/session/loop_settings.hpp"
#include "burrlab/session/record_ring.hpp"
#include "burrlab/session/tick_executor.hpp"

namespace burrlab {

class ForceGuard;
class FramedDevice;
class PassivityObserver;
class VirtualCoupling;

/// Counts since the start.
struct LoopCounts {
  std::uint64_t ticks = 0;    ///< executed
  std::uint64_t late = 0;     ///< ticks with k > 1
  std::uint64_t missed = 0;   ///< deadlines without a tick
  std::uint64_t dropped = 0;  ///< periods beyond 8 since the last tick, for which no tick stands
};

/// Energy that a burr's force gave to the hand.
struct EnergyGiven {
  double now = 0.0;   ///< so far [mJ]
  double most = 0.0;  ///< the largest so far [mJ]
};

/// A session of one or two burrs. Its members may be called by any thread; its own thread allocates, locks
/// and waits for nothing but the next deadline.
class BURRLAB_API HapticLoop {
 public:
  /// One device per burr. Holds the executor's bone from `start` to the loop's end. Throws InvalidArgument if
  /// a setting is impossible.
  HapticLoop(std::shared_ptr<TickExecutor> executor, std::vector<std::shared_ptr<Device>> devices,
             const LoopSettings& settings);
  ~HapticLoop();

  /// Returns when the thread runs; to be called once. Throws what a device throws, and if a device serves
  /// another loop or the bone is in use.
  void start();
  /// Ends the session with this reason, unless it has ended, and waits for the thread.
  void stop(const std::string& reason = "stopped");
  /// Its thread executes ticks.
  bool running() const { return running_.load(std::memory_order_acquire); }
  /// It runs, or has ended.
  bool started() const { return started_.load(std::memory_order_acquire); }
  bool wait(double seconds);  ///< waits so long for the end; returns whether it came

  /// Why the session ended; empty while it runs.
  std::string reason() const;
  /// It ended on a fault: a lost device, a stall, a value that is not finite.
  bool failed() const;
  /// What was asked of the system and granted, one sentence each.
  std::vector<std::string> realtime_notes() const;

  LoopCounts counts() const;                                 ///< so far
  EnergyGiven energy(std::size_t burr) const;                ///< of a burr, by index
  const Histogram& jitter() const { return jitter_; }        ///< |time since the last tick - whole periods|
  const Histogram& lateness() const { return lateness_; }    ///< start of a tick after its deadline
  const Histogram& tick_time() const { return tick_time_; }  ///< on the thread's CPU clock
  const Histogram& wall_time() const { return wall_time_; }  ///< of a tick on the steady clock

  const std::shared_ptr<TickExecutor>& executor() const { return executor_; }  ///< of the ticks
  std::shared_ptr<const RecordRing> ring() const { return ring_; }             ///< of the records
  std::uint64_t first_tick() const { return first_tick_; }    ///< index of the ring's record 0
  const LoopSettings& settings() const { return settings_; }  ///< as they were set
  DeviceModel model(std::size_t burr) const;                  ///< of the device, completed by the settings
  /// On a virtual clock, makes the loop wait for this reader, while it exists, instead of overrunning it.
  void add_reader(std::shared_ptr<const RecordReader> reader);

 private:
  void run();
  void watch();
  bool tick(std::uint64_t periods, double time);  // false: the session ends
  bool read_devices(std::uint64_t periods, double time, bool& waiting);
  bool read_device(std::size_t burr, std::uint64_t periods, double time, bool& waiting);
  bool send_forces(double dt);
  void rest_devices() noexcept;
  void end(const std::string& reason, bool failed);
  void wait_for_readers();
  void claim_devices();
  bool halt(const std::string& reason, bool failed = true);  // false
  void halt_devices() noexcept;
  void stop_devices() noexcept;
  void join();

  std::shared_ptr<TickExecutor> executor_;
  std::vector<std::shared_ptr<Device>> devices_;
  LoopSettings settings_;
  std::unique_ptr<VoxelBone::Changing> changing_;  // while the loop runs
  std::int64_t period_;                            // [ns]
  std::uint64_t first_tick_;
  std::shared_ptr<RecordRing> ring_;
  std::vector<std::weak_ptr<const RecordReader>> readers_;
  TickRecord record_;
  double waited_ = 0.0;               // for devices [s]
  std::vector<ForceGuard> guards_;    // one per burr, as the next three
  std::vector<FramedDevice> frames_;  // or none
  std::vector<VirtualCoupling> couplings_;
  std::vector<PassivityObserver> observers_;
  std::array<Vec3, most_burrs> wanted_;  // forces before the guards
  std::size_t stopper_ = most_burrs;     // burr whose force ends the session, with this tick

  Histogram jitter_, lateness_, tick_time_, wall_time_;
  std::atomic<std::uint64_t> ticks_{0}, late_{0}, missed_{0}, dropped_{0};
  std::array<std::atomic<double>, most_burrs> energy_{}, most_energy_{};
  std::atomic<std::int64_t> heartbeat_{0};
  std::atomic<bool> running_{false}, stopping_{false};
  std::atomic<bool> started_{false};
  std::mutex life_mutex_;  // of the next four; the threads never take it
  bool claimed_ = false;   // by this loop
  std::size_t begun_ = 0;  // devices whose start was called
  std::thread thread_, watchdog_;
  mutable std::mutex mutex_;  // of the next three; the loop takes it before its first and after its last tick
  std::string reason_;
  bool failed_ = false;
  std::vector<std::string> notes_;
};

}  // namespace burrlab
