#include "session/scripted_device.hpp"

#include <algorithm>

#include "quaternion.hpp"
#include "require.hpp"

namespace burrlab {
ScriptedDevice::ScriptedDevice(std::vector<Row> rows) : rows_(std::move(rows)) {
  if (rows_.empty()) throw InvalidArgument("a script must have at least one row, got none");
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
  const auto after = std::upper_bound(rows_.begin(), rows_.end(), time,
                                      [](double t, const Row& row) { return t < row.time; });
  const Row& last = after == rows_.begin() ? *after : *(after - 1);
  DeviceReading reading;
  reading.position = last.position;
  reading.orientation = last.orientation;
  reading.on = last.on;
  if (after == rows_.begin()) return reading;
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

ReplayDevice::ReplayDevice(std::vector<DeviceReading> ticks) : ticks_(std::move(ticks)) {
  if (ticks_.empty()) throw InvalidArgument("a recording must have at least one tick, got none");
  for (const DeviceReading& tick : ticks_) {
    require_finite("position", tick.position);
    require_finite("velocity", tick.velocity);
    require_unit("orientation", tick.orientation);
  }
}

DeviceReading ReplayDevice::read(double, std::uint64_t) noexcept {
  if (next_ < ticks_.size()) return ticks_[next_++];
  DeviceReading end;
  end.status = DeviceReading::Status::finished;
  return end;
}

}  // namespace burrlab
