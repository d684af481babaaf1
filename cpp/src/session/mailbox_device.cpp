#include "session/mailbox_device.hpp"

#include <chrono>

#include "quaternion.hpp"
#include "require.hpp"

namespace burrlab {
namespace {

std::uint64_t now() {
  using namespace std::chrono;
  return std::uint64_t(duration_cast<nanoseconds>(steady_clock::now().time_since_epoch()).count());
}

}  // namespace

MailboxDevice::MailboxDevice(double lost_after, std::string name, DeviceModel model)
    : lost_after_(lost_after), name_(std::move(name)), model_(model) {
  require_positive("lost_after", lost_after);
}

void MailboxDevice::put_of(std::uint64_t time, const Vec3& position, const Vec3& velocity, bool on,
                           const Quaternion& orientation, std::uint8_t buttons) {
  Letter letter{};
  for (int axis = 0; axis < 3; ++axis) {
    require_finite("position", letter.position[axis] = position[axis]);
    require_finite("velocity", letter.velocity[axis] = velocity[axis]);
  }
  require_unit("orientation", orientation);
  letter.orientation = orientation;
  letter.on = on;
  letter.buttons = buttons;
  letter.time = time ? time : now();
  in_.put(letter);
}

Vec3 MailboxDevice::force() const {
  std::array<double, 3> force{};
  if (halted_.load(std::memory_order_acquire)) return Vec3::Zero();
  out_.get(force, 1000);
  return {force[0], force[1], force[2]};
}

bool MailboxDevice::has_value() const {
  Letter letter{};
  return in_.get(letter, 1000) && letter.time != 0;
}

void MailboxDevice::fail(const std::string& reason) {
  const std::lock_guard<std::mutex> lock(fail_mutex_);
  if (failed_.load(std::memory_order_acquire)) return;
  fault_ = reason;
  failed_.store(true, std::memory_order_release);
  halt();
}

void MailboxDevice::start(double) {
  if (failed_.load(std::memory_order_acquire))
    throw std::invalid_argument(name_ + " must be opened anew: " + fault_);
  halted_.store(false, std::memory_order_release);
}

DeviceReading MailboxDevice::read(double, std::uint64_t) noexcept {
  in_.get(last_);  // else the last letter, with its age
  DeviceReading reading;
  if (failed_.load(std::memory_order_acquire)) {
    reading.status = DeviceReading::Status::lost;
    return reading;
  }
  if (last_.time == 0) {
    reading.status = DeviceReading::Status::waiting;
    return reading;
  }
  for (int axis = 0; axis < 3; ++axis) {
    reading.position[axis] = last_.position[axis];
    reading.velocity[axis] = last_.velocity[axis];
  }
  reading.orientation = last_.orientation;
  reading.buttons = last_.buttons;
  reading.on = last_.on != 0;
  const std::uint64_t here = now();
  reading.age = here > last_.time ? 1e-6 * double(here - last_.time) : 0.0;
  if (reading.age > lost_after_) reading.status = DeviceReading::Status::lost;
  return reading;
}

void MailboxDevice::write(const Vec3& force) noexcept { out_.put({force[0], force[1], force[2]}); }

}  // namespace burrlab
