// A device moves a burr and feels its force: a haptic device, a simulated hand, a recording, a network peer.
//
//     class Arm : public burrlab::Device {
//      public:
//       burrlab::DeviceReading read(double, std::uint64_t) noexcept override { return driver.position(); }
//       void write(const burrlab::Vec3& force) noexcept override { driver.send(force); }
//       void halt() noexcept override { driver.send(burrlab::Vec3::Zero()); }
//       std::string name() const override { return "arm"; }
//     };
#pragma once

#include <atomic>
#include <cstdint>
#include <limits>
#include <string>

#include "burrlab/types.hpp"

namespace burrlab {

/// What a device returns when it is read.
struct DeviceReading {
  Vec3 position = Vec3::Zero();  ///< of the burr's centre, bone frame [mm]
  Vec3 velocity = Vec3::Zero();  ///< [mm/s]
  /// Unit quaternion (w, x, y, z) that turns directions of the tool into those of the bone; 1 if unknown.
  Quaternion orientation{1.0, 0.0, 0.0, 0.0};
  std::uint8_t buttons = 0;  ///< bit i: button i is pressed
  bool on = false;           ///< the burr turns
  double age = 0.0;          ///< of the position [ms]
  /// Whether the device still moves the burr.
  enum class Status {
    ok,                   ///< the reading holds
    waiting,              ///< no position yet: no tick is executed
    finished,             ///< the session ends without a fault
    lost                  ///< the session stops, with zero force
  } status = Status::ok;  ///< of the device
};

/// What the passivity limit needs of a device; NaN if unknown.
struct DeviceModel {
  double damping = std::numeric_limits<double>::quiet_NaN();       ///< of device and hand, b [N s/m]
  double encoder_step = std::numeric_limits<double>::quiet_NaN();  ///< Delta [mm]
  double friction = std::numeric_limits<double>::quiet_NaN();      ///< Coulomb friction f_c [N]
  /// From reading a position to the middle of the time in which its force acts, T/2 + t_d [ms].
  double delay = std::numeric_limits<double>::quiet_NaN();
};

/// The loop calls `read` and `write` in turn, in its thread. Neither may wait, lock, allocate or throw.
class BURRLAB_API Device {
 public:
  virtual ~Device() = default;

  /// Before the first tick; `period` of the loop [s]. If it throws, the session does not start.
  virtual void start(double period) { static_cast<void>(period); }
  /// Newest reading. `time` [s] since the session's start; `periods` since the last reading, at least 1.
  virtual DeviceReading read(double time, std::uint64_t periods) noexcept = 0;
  /// Force on the hand [N], once a tick.
  virtual void write(const Vec3& force) noexcept = 0;
  /// Sets the force to zero until another session starts. The watchdog calls it from another thread.
  virtual void halt() noexcept = 0;
  /// After the last tick.
  virtual void stop() noexcept {}

  virtual std::string name() const = 0;             ///< for the session's report
  virtual std::string fault() const { return {}; }  ///< why it was lost, empty if it does not say
  virtual DeviceModel model() const { return {}; }  ///< what it knows of itself
  /// It moves by itself. While another device waits it is not read, and its `time` stands still.
  virtual bool simulated() const noexcept { return false; }

  /// A loop claims the device; false if another has it.
  bool claim() noexcept { return !claimed_.exchange(true, std::memory_order_acq_rel); }
  /// Gives the claim back.
  void release() noexcept { claimed_.store(false, std::memory_order_release); }

 private:
  std::atomic<bool> claimed_{false};
};

}  // namespace burrlab
