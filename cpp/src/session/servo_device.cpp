#include "session/servo_device.hpp"

#include <algorithm>
#include <chrono>

#include "quaternion.hpp"
#include "require.hpp"
#include "session/realtime.hpp"

namespace burrlab {

constexpr std::int64_t start_limit = 1000000000, stop_limit = 500000000;  // [ns]
constexpr std::chrono::microseconds look(200);                            // between two looks
constexpr double mean_weight = 1e-3;                                      // of a cycle in the mean delay

ServoDevice::ServoDevice(std::string name, const ServoSettings& settings)
    : name_(std::move(name)), settings_(settings) {
  require_positive("lost_after", settings.lost_after);
  if (settings.on_button < -1 || settings.on_button > 7)
    refuse("on_button", "0 to 7, or none", settings.on_button);
}

void ServoDevice::start(double) {
  if (keep_)
    throw InvalidArgument(name_ + " must wait for a new start of the program: its servo did not end");
  in_.put({});
  out_.put({});
  last_ = {};
  order_ = {};
  delay_.store(0.0);
  fault_.store(0);
  closing_.store(false);
  halted_.store(false);
  keep_ = shared_from_this();
  ended_.store(false);
  try {
    begin();
  } catch (...) {
    switch_force_off();
    ended_.store(true);
    keep_.reset();
    throw;
  }
  wait_until(steady_now() + start_limit, look,
             [&] { return fault_.load() != 0 || (in_.get(last_) && last_.time != 0); });
  if (fault_.load() == 0 && last_.time != 0) return;
  const std::string why = fault();
  stop();
  throw InvalidArgument(name_ + " must give positions: " + (why.empty() ? "none came within 1 s" : why));
}

void ServoDevice::stop() noexcept {
  if (!keep_) return;
  halt();
  closing_.store(true, std::memory_order_release);
  const bool ended =
      wait_until(steady_now() + stop_limit, look, [this] { return ended_.load(std::memory_order_acquire); });
  end(ended);
  if (ended) keep_.reset();  // else the servo may still call, and the device stays
}

Vec3 ServoDevice::newest_force() noexcept {
  out_.get(order_);
  const std::int64_t now = steady_now();
  if (order_.time != 0) {
    const double delay = 1e-6 * (double(now - order_.time) + 0.5 * double(now - sent_)), mean = delay_.load();
    delay_.store(mean == 0.0 ? delay : mean + mean_weight * (delay - mean));
  }
  sent_ = now;
  const bool halted = halted_.load(std::memory_order_acquire);
  return halted ? Vec3(Vec3::Zero()) : Vec3(order_.force.data());
}

bool ServoDevice::cycle() noexcept {
  Pose pose;
  int code = fresh;
  if (!closing_.load(std::memory_order_acquire)) {
    code = exchange(pose);
    Quaternion orientation;
    if (code == fresh && !to_quaternion(Eigen::Map<const RotationRows>(pose.rotation.data()), orientation))
      code = no_rotation;
    if (code == fresh) in_.put({pose.position, pose.velocity, orientation, pose.buttons, steady_now()});
    if (code == fresh || code == old) return true;
    fault_.store(code, std::memory_order_release);
  }
  switch_force_off();
  ended_.store(true, std::memory_order_release);
  return false;
}

DeviceReading ServoDevice::read(double, std::uint64_t) noexcept {
  in_.get(last_);  // else the last letter, with its age
  DeviceReading reading;
  reading.position = to_vector(last_.position);
  reading.velocity = to_vector(last_.velocity);
  if (last_.time != 0) reading.orientation = last_.orientation;
  reading.buttons = std::uint8_t(last_.buttons);
  reading.on = settings_.on_button < 0 || (reading.buttons >> settings_.on_button & 1u);
  reading.age = std::max(0.0, 1e-6 * double(steady_now() - last_.time));
  if (fault_.load(std::memory_order_acquire) != 0 || reading.age > settings_.lost_after) {
    halt();
    reading.status = DeviceReading::Status::lost;
  }
  return reading;
}

DeviceModel ServoDevice::model() const {
  DeviceModel model;
  if (const double delay = delay_.load(); delay > 0.0) model.delay = delay;
  return model;
}

std::string ServoDevice::fault() const {
  const int code = fault_.load(std::memory_order_acquire);
  if (code == 0) return {};
  if (code == no_rotation) return name_ + " gave an orientation that is not a rotation";
  return name_ + " failed: " + described(code);
}

}  // namespace burrlab
