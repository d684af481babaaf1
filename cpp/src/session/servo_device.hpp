// Haptic devices that a vendor's servo drives: a Touch or PHANToM over libHD, an Omega, Delta or Falcon over
// libdhd.
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <thread>

#include "burrlab/session/device.hpp"
#include "session/latest.hpp"
#include "session/vendor_library.hpp"

namespace burrlab {

struct ServoSettings {
  double lost_after = 100.0;  ///< age at which the position is lost [ms]
  int on_button = -1;         ///< 0 to 7; the burr turns while it is pressed; -1: always
};

/// The servo runs at the device's own rate in another thread. It leaves the newest reading for the loop, and
/// sends the newest force of the loop; zero after `halt`, a fault, or when the loop finds the device lost.
class ServoDevice : public Device, public std::enable_shared_from_this<ServoDevice> {
 public:
  /// Returns when the servo has given a position; throws if it gives none, or a fault, within a second.
  void start(double period) override;
  DeviceReading read(double time, std::uint64_t periods) noexcept override;
  void write(const Vec3& force) noexcept override { out_.put({{force[0], force[1], force[2]}, last_.time}); }
  void halt() noexcept override { halted_.store(true, std::memory_order_release); }
  void stop() noexcept override;
  std::string name() const override { return name_; }
  std::string fault() const override;                        ///< why the servo ended, empty without a fault
  const std::string& hardware() const { return hardware_; }  ///< the model, as the library names it
  virtual const std::string& library() const = 0;            ///< its file
  DeviceModel model() const override;  ///< only its delay, a mean over about a thousand cycles

 protected:
  struct Pose {
    std::array<double, 3> position, velocity;  // [mm], [mm/s]
    std::array<double, 9> rotation;            // by rows
    std::uint32_t buttons = 0;
  };
  static constexpr int fresh = 0,
                       old = -1;  // of `exchange`; else the library's error code, which is positive

  ServoDevice(std::string name, const ServoSettings& settings);
  bool cycle() noexcept;  // for the servo; false if it must end
  void set_hardware(const char* text) { hardware_ = to_string(text); }
  static std::string to_string(const char* text) { return text ? text : "unknown"; }

  Vec3 newest_force() noexcept;                   // for `exchange`, when it sends it
  virtual int exchange(Pose& pose) noexcept = 0;  // reads, and sends the newest force
  virtual void switch_force_off() noexcept = 0;   // force zero, and off
  virtual void begin() = 0;                       // force on, servo on
  virtual void end(bool servo_ended) noexcept = 0;
  virtual std::string error_text(int code) const = 0;
  std::string described(int code) const { return error_text(code) + " (error " + std::to_string(code) + ")"; }

 private:
  struct Letter {
    std::array<double, 3> position, velocity;
    Quaternion orientation;
    std::uint64_t buttons;
    std::int64_t time;  // steady clock [ns]; 0: none yet
  };
  struct Order {
    std::array<double, 3> force;
    std::int64_t time;  // when the position was read that it answers [ns]; 0: none yet
  };
  static constexpr int no_rotation = -2;  // a fault that is not the library's

  Latest<Letter> in_;
  Latest<Order> out_;
  Letter last_{};          // of the loop
  Order order_{};          // of the servo, as the next
  std::int64_t sent_ = 0;  // when it sent the last one [ns]
  std::atomic<double> delay_{0.0};
  std::atomic<bool> halted_{false}, closing_{false}, ended_{true};
  std::atomic<int> fault_{0};
  std::shared_ptr<ServoDevice> keep_;  // while the servo may call
  std::string name_, hardware_;
  ServoSettings settings_;
};

/// Position in the axes of libHD: x right, y up, z towards the user.
class TouchDevice : public ServoDevice {
 public:
  /// Opens the device of this name in the vendor's set-up, "" for its default one. Throws if there is none,
  /// another has opened it, or it must be calibrated.
  explicit TouchDevice(const std::string& name = "", const ServoSettings& settings = {},
                       const std::string& library = "");
  ~TouchDevice() override;
  const std::string& library() const override { return hd_->path(); }

 private:
  int exchange(Pose& pose) noexcept override;
  void switch_force_off() noexcept override;
  void begin() override;
  void end(bool servo_ended) noexcept override;
  std::string error_text(int code) const override { return to_string(hd_->hdGetErrorString(unsigned(code))); }
  int take_error() noexcept;

  std::shared_ptr<HdLibrary> hd_;
  unsigned handle_ = 0;
  unsigned long scheduled_ = 0;
  bool force_on_ = false;  // of the servo
};

/// Position in the axes of libdhd: x towards the user, y right, z up.
class OmegaDevice : public ServoDevice {
 public:
  /// Opens the device of this index, from 0. Throws as a TouchDevice does.
  explicit OmegaDevice(int index = 0, const ServoSettings& settings = {}, const std::string& library = "");
  ~OmegaDevice() override;
  const std::string& library() const override { return dhd_->path(); }
  static int count(const std::string& library = "");  ///< devices that the library finds

 private:
  int exchange(Pose& pose) noexcept override;
  void switch_force_off() noexcept override;
  void begin() override;
  void end(bool servo_ended) noexcept override;
  std::string error_text(int code) const override { return to_string(dhd_->dhdErrorGetStr(code)); }

  std::shared_ptr<DhdLibrary> dhd_;
  char id_ = 0;
  std::thread thread_;
};

}  // namespace burrlab
