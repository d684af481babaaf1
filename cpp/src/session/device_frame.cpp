#include "session/device_frame.hpp"

#include "quaternion.hpp"
#include "require.hpp"

namespace burrlab {

FramedDevice::FramedDevice(const DeviceFrame& frame)
    : frame_(frame),
      rotation_(to_eigen(frame.rotation).normalized().toRotationMatrix()),
      offset_(frame.offset) {
  require_positive("scale of a frame", frame.scale);
  require_unit("rotation of a frame", frame.rotation);
  require_finite("offset of a frame", frame.offset);
  if (frame.clutch < -1 || frame.clutch > 7) refuse("clutch", "-1 or a button, 0 to 7", frame.clutch);
}

void FramedDevice::apply(DeviceReading& reading) noexcept {
  const Vec3 turned = frame_.scale * (rotation_ * reading.position);
  held_ = frame_.clutch >= 0 && (reading.buttons >> frame_.clutch & 1);
  if (held_) {
    if (begun_) offset_ = last_ - turned;
    reading.on = false;
  }
  reading.velocity = held_ ? Vec3::Zero().eval() : (frame_.scale * (rotation_ * reading.velocity)).eval();
  reading.position = held_ && begun_ ? last_ : (turned + offset_).eval();
  const Eigen::Quaterniond tool = to_eigen(frame_.rotation).normalized() * to_eigen(reading.orientation);
  reading.orientation = {tool.w(), tool.x(), tool.y(), tool.z()};
  last_ = reading.position;
  begun_ = true;
}

}  // namespace burrlab
