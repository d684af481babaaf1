// A device that lives in another thread: it leaves its newest position in a mailbox and takes the force
// there.
#pragma once

#include <array>
#include <atomic>

#include "burrlab/session/device.hpp"
#include "burrlab/session/latest.hpp"

namespace burrlab {

/// Holds the latest value, with its age; 100 ms old (or what `lost_after` says) is lost.
class MailboxDevice : public Device {
 public:
  /// lost_after [ms]; `name` for the report. Before the first position the device is waited for, not lost.
  explicit MailboxDevice(double lost_after = 100.0, std::string name = "mailbox", DeviceModel model = {});

  /// The newest position [mm], velocity [mm/s] and switch; throws if not finite.
  void put(const Vec3& position, const Vec3& velocity, bool on);
  Vec3 force() const;      ///< that the loop sent last; 0 after `halt` [N]
  bool has_value() const;  ///< a position was put

  void start(double) override { halted_.store(false, std::memory_order_release); }
  DeviceReading read(double time, std::uint64_t periods) noexcept override;
  void write(const Vec3& force) noexcept override;
  void halt() noexcept override { halted_.store(true, std::memory_order_release); }
  std::string name() const override { return name_; }
  DeviceModel model() const override { return model_; }

 private:
  struct Letter {
    std::array<double, 3> position, velocity;
    std::uint64_t on;
    std::uint64_t time;  // steady clock [ns]; 0: none yet
  };
  Latest<Letter> in_;
  Latest<std::array<double, 3>> out_;
  Letter last_{};
  std::atomic<bool> halted_{false};
  double lost_after_;
  std::string name_;
  DeviceModel model_;
};

}  // namespace burrlab
