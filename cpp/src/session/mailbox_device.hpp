// A device in another thread, which leaves its newest position in a mailbox and takes the force from it.
#pragma once

#include <mutex>

#include "session/sent_force_device.hpp"

namespace burrlab {

/// Holds the newest position and its age; the device is lost when it is older than `lost_after`.
class MailboxDevice : public SentForceDevice {
 public:
  /// lost_after [ms]; `name` for the report. Until a position of this session comes the device is awaited,
  /// not lost.
  explicit MailboxDevice(double lost_after = 100.0, std::string name = "mailbox");

  /// Sets position [mm], velocity [mm/s], switch, orientation and buttons (DeviceReading); throws if a number
  /// is not finite or the orientation is not of length 1.
  void put(const Vec3& position, const Vec3& velocity, bool on,
           const Quaternion& orientation = {1.0, 0.0, 0.0, 0.0}, std::uint8_t buttons = 0) {
    put_of(0, position, velocity, on, orientation, buttons);
  }
  /// The device is lost, for this reason, and cannot be started again; the first reason counts.
  void fail(const std::string& reason);

  void start(double) override;
  DeviceReading read(double time, std::uint64_t periods) noexcept override;
  std::string name() const override { return name_; }
  std::string fault() const override { return failed_.load(std::memory_order_acquire) ? fault_ : ""; }

 protected:
  /// As `put`, of a position that came at `time` on the steady clock [ns]; 0 is now.
  void put_of(std::uint64_t time, const Vec3& position, const Vec3& velocity, bool on,
              const Quaternion& orientation, std::uint8_t buttons);

 private:
  double age() const noexcept;  // of the last letter [ms]
  struct Letter {
    std::array<double, 3> position, velocity;
    Quaternion orientation;
    std::uint8_t on, buttons, padding[6];
    std::uint64_t time;  // steady clock [ns]; 0: none yet
  };
  Latest<Letter> in_;
  Letter last_{};
  std::uint64_t old_ = 0;  // time of an earlier session's letter that is too old for this one
  std::atomic<bool> failed_{false};
  double lost_after_;
  std::string name_, fault_;  // the fault is written once, before failed_
  std::mutex fail_mutex_;
};

}  // namespace burrlab
