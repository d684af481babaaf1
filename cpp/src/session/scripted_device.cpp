#include "session/scripted_device.hpp"

#include <algorithm>

#include "quaternion.hpp"
#include "require.hpp"

namespace burrlab {
namespace {

Vec3 sent(const Latest<std::array<double, 3>>& cell, const std::atomic<bool>& halted) {
  std::array<double, 3> force{};
  if (!halted.load(std::memory_order_acquire)) cell.get(force, 1000);
  return {force[0], force[1], force[2]};
}

}  // namespace

ScriptedDevice::ScriptedDevice(std::vector<Row> rows) : rows_(std::move(rows)) {
  if (rows_.empty()) throw std::invalid_argument("a script must have at least one row, got none");
  for (std::size_t i = 0; i < rows_.size(); ++i) {
    require_finite("time", rows_[i].time);
    for (const double x : rows_[i].position) require_finite("position", x);
    require_unit("orientation", rows_[i].orientation);
    if (i > 0 && !(rows_[i].time > rows_[i - 1].time)) {
      std::ostringstream rule;
      rule.precision(12);
      rule << "increasing: after " << rows_[i - 1].time << " s";
      refuse("time", rule.str(), rows_[i].time);
    }
  }
}

DeviceReading ScriptedDevice::read(double time, std::uint64_t) noexcept {
  DeviceReading reading;
  const auto after = std::upper_bound(rows_.begin(), rows_.end(), time,
                                      [](double t, const Row& row) { return t < row.time; });
  if (after == rows_.begin()) {
    reading.position = rows_.front().position;
    reading.orientation = rows_.front().orientation;
    reading.on = rows_.front().on;
    return reading;
  }
  const Row& last = *(after - 1);
  reading.position = last.position;
  reading.orientation = last.orientation;
  reading.on = last.on;
  if (after == rows_.end()) {
    if (time > last.time) reading.status = DeviceReading::Status::finished;
    return reading;
  }
  reading.velocity = (after->position - last.position) / (after->time - last.time);
  reading.position += (time - last.time) * reading.velocity;
  reading.orientation =
      between(last.orientation, after->orientation, (time - last.time) / (after->time - last.time));
  return reading;
}

Vec3 ScriptedDevice::force() const { return sent(out_, halted_); }

ReplayDevice::ReplayDevice(std::vector<Tick> ticks) : ticks_(std::move(ticks)) {
  if (ticks_.empty()) throw std::invalid_argument("a recording must have at least one tick, got none");
  for (const Tick& tick : ticks_) {
    for (const double x : tick.position) require_finite("position", x);
    for (const double v : tick.velocity) require_finite("velocity", v);
    require_unit("orientation", tick.orientation);
    if (tick.k < 1 || tick.k > std::uint32_t(most_periods)) refuse("k", "1 to 8", tick.k);
  }
}

DeviceReading ReplayDevice::read(double, std::uint64_t) noexcept {
  DeviceReading reading;
  const std::size_t i = next_.load(std::memory_order_relaxed);
  if (i >= ticks_.size()) {
    reading.status = DeviceReading::Status::finished;
    return reading;
  }
  reading.position = ticks_[i].position;
  reading.velocity = ticks_[i].velocity;
  reading.orientation = ticks_[i].orientation;
  reading.buttons = ticks_[i].buttons;
  reading.on = ticks_[i].on;
  next_.store(i + 1, std::memory_order_release);
  return reading;
}

Vec3 ReplayDevice::force() const { return sent(out_, halted_); }

}  // namespace burrlab
