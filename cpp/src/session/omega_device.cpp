#include <algorithm>

#include "require.hpp"
#include "session/realtime.hpp"
#include "session/servo_device.hpp"

namespace burrlab {

// dhdc.h, from the Force Dimension SDK's documentation.
constexpr int time_guard = 1;  // no new position yet
constexpr int in_reset = 3;    // of the status: the device waits to be calibrated
constexpr int device_in_use = 20;
constexpr double millimetre = 1e3;            // in a metre
constexpr std::int64_t least_cycle = 250000;  // [ns]; the devices' rate is up to 4 kHz
constexpr std::int64_t least_rest = 20000;    // [ns]; leaves the processor to others

int OmegaDevice::count(const std::string& library) {
  return std::max(0, shared_library<DhdLibrary>(library)->dhdGetDeviceCount());
}

OmegaDevice::OmegaDevice(int index, const ServoSettings& settings, const std::string& library)
    : ServoDevice("omega:" + std::to_string(index), settings), dhd_(shared_library<DhdLibrary>(library)) {
  const std::lock_guard<std::mutex> lock(dhd_->mutex);
  const int found = std::min(dhd_->dhdGetDeviceCount(), 127);
  if (found < 1) throw InvalidArgument(name() + " must be connected and switched on: no device was found");
  if (index < 0 || index >= found) refuse("index of an omega", "0 to " + std::to_string(found - 1), index);
  const int id = dhd_->dhdOpenID(char(index));
  const int code = id < 0 ? dhd_->dhdErrorGetLast() : 0;
  if (code == device_in_use || dhd_->open.count(id))
    throw InvalidArgument(name() + " must be a device of its own: it is open already");
  if (id < 0) throw InvalidArgument(name() + " must be a device that can be opened: " + described(code));
  id_ = char(id);
  int status[64] = {};  // more than any version fills
  if (dhd_->dhdGetStatus(status, id_) < 0 || status[in_reset]) {
    dhd_->dhdClose(id_);
    throw InvalidArgument(name() +
                          " must be calibrated: put its pole into the calibration pit until the "
                          "lamp stops blinking");
  }
  set_hardware(dhd_->dhdGetSystemName(id_));
  dhd_->open[id] = true;
}

OmegaDevice::~OmegaDevice() {
  const std::lock_guard<std::mutex> lock(dhd_->mutex);
  dhd_->dhdClose(id_);
  dhd_->open.erase(id_);
}

int OmegaDevice::exchange(Pose& pose) noexcept {
  double rotation[3][3] = {};
  auto& [x, y, z] = pose.position;
  auto& [vx, vy, vz] = pose.velocity;
  const int read = dhd_->dhdGetPositionAndOrientationFrame(&x, &y, &z, rotation, id_);  // may wait a cycle
  if (read < 0 || dhd_->dhdGetLinearVelocity(&vx, &vy, &vz, id_) < 0)
    return std::max(1, dhd_->dhdErrorGetLast());
  const Vec3 force = newest_force();
  if (dhd_->dhdSetForce(force[0], force[1], force[2], id_) < 0) return std::max(1, dhd_->dhdErrorGetLast());
  pose.buttons = dhd_->dhdGetButtonMask(id_);
  for (int i = 0; i < 3; ++i) {
    pose.position[i] *= millimetre;
    pose.velocity[i] *= millimetre;
    std::copy_n(rotation[i], 3, &pose.rotation[3 * i]);
  }
  return read == time_guard ? old : fresh;
}

void OmegaDevice::switch_force_off() noexcept {
  dhd_->dhdSetForce(0.0, 0.0, 0.0, id_);
  dhd_->dhdEnableForce(0, id_);
}

void OmegaDevice::begin() {
  if (dhd_->dhdEnableForce(1, id_) < 0)
    throw InvalidArgument(name() +
                          " must let its force be switched on: " + described(dhd_->dhdErrorGetLast()));
  dhd_->dhdEmulateButton(1, id_);  // a gripper that is closed is button 0; without a gripper an error
  thread_ = std::thread([this] {
    RealtimeRequest request;
    request.lock_memory = false;
    become_realtime(request);
    std::int64_t begun = steady_now();
    while (cycle()) {
      sleep_until(std::max(begun + least_cycle, steady_now() + least_rest));
      begun = steady_now();
    }
  });
}

void OmegaDevice::end(bool servo_ended) noexcept {
  if (servo_ended)
    thread_.join();
  else
    thread_.detach();
}

}  // namespace burrlab
