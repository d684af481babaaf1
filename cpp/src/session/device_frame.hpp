// Where a device stands beside the bone: so that a small workspace reaches all of it.
#pragma once

#include <Eigen/Geometry>

#include "burrlab/session/loop_settings.hpp"

namespace burrlab {

/// One device in its frame. Holding the clutch moves the offset with the device.
class FramedDevice {
 public:
  /// Throws unless the scale is positive, the rotation of length 1, the offset finite, the clutch -1 to 7.
  explicit FramedDevice(const DeviceFrame& frame = {});

  /// Turns a reading into the bone's frame.
  void apply(DeviceReading& reading) noexcept;
  bool held() const { return held_; }  ///< the clutch, in the last reading
  /// A force on the hand along the device's axes.
  Vec3 to_device(const Vec3& force) const noexcept { return rotation_.transpose() * force; }
  double scale() const { return frame_.scale; }

 private:
  DeviceFrame frame_;
  Eigen::Matrix3d rotation_;
  Vec3 offset_, last_ = Vec3::Zero();
  bool begun_ = false, held_ = false;
};

}  // namespace burrlab
