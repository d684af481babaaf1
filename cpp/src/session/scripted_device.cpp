#include "session/scripted_device.hpp"

#include <algorithm>

#include "quaternion.hpp"
#include "require.hpp"

namespace burrlab {
ScriptedDevice::ScriptedDevice(std::vector<Row> rows) : rows_(std::move(rows)) {
  if (rows_.empty()) throw std::invalid_argument("a script must have at least one row, got none");
  for (std::size_t i = 0; i < rows_.size(); ++i) {
    require_finite("time", rows_[i].time);
    require_finite("position", rows_[i].position);
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

ReplayDevice::ReplayDevice(std::vector<Tick> ticks) : ticks_(std::move(ticks)) {
  if (ticks_.empty()) throw std::invalid_argument("a recording must have at least one tick, got none");
  for (const Tick& tick : ticks_) {
    require_finite("position", tick.position);
    require_finite("velocity", tick.velocity);
    require_unit("orientation", tick.orientation);
  }
}

DeviceReading ReplayDevice::read(double, std::uint64_t) noexcept {
  DeviceReading reading;
  if (next_ == ticks_.size()) {
    reading.status = DeviceReading::Status::finished;
    return reading;
  }
  const Tick& tick = ticks_[next_++];
  reading.position = tick.position;
  reading.velocity = tick.velocity;
  reading.orientation = tick.orientation;
  reading.buttons = tick.buttons;
  reading.on = tick.on;
  return reading;
}

}  // namespace burrlab
