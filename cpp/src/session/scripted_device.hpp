// Devices with a known motion: a table over time, or the positions of recorded ticks.
#pragma once

#include <array>
#include <atomic>
#include <vector>

#include "burrlab/session/device.hpp"
#include "burrlab/session/tick_record.hpp"
#include "session/latest.hpp"

namespace burrlab {

/// Moves along straight lines between the rows of a table and turns the shorter way. Stays at the first row
/// until its time; ends the session after the last.
class ScriptedDevice : public Device {
 public:
  struct Row {
    double time = 0.0;                           ///< [s]
    Vec3 position = Vec3::Zero();                ///< [mm]
    bool on = true;                              ///< from this row to the next
    Quaternion orientation{1.0, 0.0, 0.0, 0.0};  ///< DeviceReading::orientation
  };

  /// Throws unless there are rows, finite, with increasing times.
  explicit ScriptedDevice(std::vector<Row> rows);

  void start(double) override { halted_.store(false, std::memory_order_release); }
  DeviceReading read(double time, std::uint64_t periods) noexcept override;
  void write(const Vec3& force) noexcept override { out_.put({force[0], force[1], force[2]}); }
  void halt() noexcept override { halted_.store(true, std::memory_order_release); }
  std::string name() const override { return "script"; }

  Vec3 force() const;                                    ///< last sent by the loop [N]
  double duration() const { return rows_.back().time; }  ///< [s]
  const std::vector<Row>& rows() const { return rows_; }

 private:
  std::vector<Row> rows_;
  std::atomic<bool> halted_{false};
  Latest<std::array<double, 3>> out_;
};

/// Gives the device's side of recorded ticks, one per reading, then ends the session. `k` is what a tick
/// stood for; a loop on a virtual clock still takes one period per tick.
class ReplayDevice : public Device {
 public:
  struct Tick {
    Vec3 position = Vec3::Zero();  ///< [mm]
    Vec3 velocity = Vec3::Zero();  ///< [mm/s]
    bool on = true;
    std::uint32_t k = 1;
    Quaternion orientation{1.0, 0.0, 0.0, 0.0};  ///< DeviceReading::orientation
    std::uint8_t buttons = 0;
  };

  /// Throws unless there are ticks, finite, with k in 1..8.
  explicit ReplayDevice(std::vector<Tick> ticks);

  void start(double) override {
    next_.store(0, std::memory_order_release);
    halted_.store(false, std::memory_order_release);
  }
  DeviceReading read(double time, std::uint64_t periods) noexcept override;
  void write(const Vec3& force) noexcept override { out_.put({force[0], force[1], force[2]}); }
  void halt() noexcept override { halted_.store(true, std::memory_order_release); }
  std::string name() const override { return "replay"; }

  Vec3 force() const;  ///< last sent by the loop [N]
  const std::vector<Tick>& ticks() const { return ticks_; }
  std::size_t next() const { return next_.load(std::memory_order_acquire); }  ///< number of the next tick

 private:
  std::vector<Tick> ticks_;
  std::atomic<std::size_t> next_{0};
  std::atomic<bool> halted_{false};
  Latest<std::array<double, 3>> out_;
};

}  // namespace burrlab
