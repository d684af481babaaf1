#include "session/mailbox_device.hpp"

#include <algorithm>

#include "quaternion.hpp"
#include "require.hpp"
#include "session/realtime.hpp"

namespace burrlab {
MailboxDevice::MailboxDevice(double lost_after, std::string name)
    : lost_after_(lost_after), name_(std::move(name)) {
  require_positive("lost_after", lost_after);
}

void MailboxDevice::put_of(std::uint64_t time, const Vec3& position, const Vec3& velocity, bool on,
                           const Quaternion& orientation, std::uint8_t buttons) {
  require_finite("position", position);
  require_finite("velocity", velocity);
  require_unit("orientation", orientation);
  Letter letter{{}, {}, orientation, on, buttons, {}, time ? time : std::uint64_t(steady_now())};
  std::copy_n(position.data(), 3, letter.position.begin());
  std::copy_n(velocity.data(), 3, letter.velocity.begin());
  in_.put(letter);
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
    throw InvalidArgument(name_ + " must be opened anew: " + fault_);
  resume();
  old_ = age() > lost_after_ ? last_.time : 0;
}

double MailboxDevice::age() const noexcept {
  return std::max(1e-6 * double(steady_now() - std::int64_t(last_.time)), 0.0);
}

DeviceReading MailboxDevice::read(double, std::uint64_t) noexcept {
  in_.get(last_);  // else the last letter, with its age
  DeviceReading reading;
  if (last_.time == old_) reading.status = DeviceReading::Status::waiting;
  if (failed_.load(std::memory_order_acquire)) reading.status = DeviceReading::Status::lost;
  if (reading.status != DeviceReading::Status::ok) return reading;
  reading.position = to_vector(last_.position);
  reading.velocity = to_vector(last_.velocity);
  reading.orientation = last_.orientation;
  reading.buttons = last_.buttons;
  reading.on = last_.on != 0;
  reading.age = age();
  if (reading.age > lost_after_) reading.status = DeviceReading::Status::lost;
  return reading;
}

}  // namespace burrlab
