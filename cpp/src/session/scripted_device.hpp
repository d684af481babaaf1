// Devices with a known motion: a table over time, or the positions of recorded ticks.
#pragma once

#include <vector>

#include "session/sent_force_device.hpp"

namespace burrlab {

/// Moves along straight lines between the rows of a table and turns the shorter way. Stays at the first row
/// until its time; ends the session after the last.
class ScriptedDevice : public SentForceDevice {
 public:
  struct Row {
    double time = 0.0;                           ///< [s]
    Vec3 position = Vec3::Zero();                ///< [mm]
    bool on = true;                              ///< from this row to the next
    Quaternion orientation{1.0, 0.0, 0.0, 0.0};  ///< DeviceReading::orientation
  };

  /// Throws unless there are rows, finite, with increasing times.
  explicit ScriptedDevice(std::vector<Row> rows);

  void start(double) override { resume(); }
  DeviceReading read(double time, std::uint64_t periods) noexcept override;
  bool simulated() const noexcept override { return true; }
  std::string name() const override { return "script"; }

  double duration() const { return rows_.back().time; }  ///< [s]
  const std::vector<Row>& rows() const { return rows_; }

 private:
  std::vector<Row> rows_;
};

/// Gives the device's side of recorded ticks, one per reading, then ends the session.
class ReplayDevice : public SentForceDevice {
 public:
  /// Throws unless there are ticks, with finite numbers.
  explicit ReplayDevice(std::vector<DeviceReading> ticks);

  void start(double) override {
    next_ = 0;
    resume();
  }
  DeviceReading read(double time, std::uint64_t periods) noexcept override;
  bool simulated() const noexcept override { return true; }
  std::string name() const override { return "replay"; }

  std::size_t size() const { return ticks_.size(); }

 private:
  std::vector<DeviceReading> ticks_;
  std::size_t next_ = 0;  // number of the next tick
};

}  // namespace burrlab
