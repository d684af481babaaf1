#include "network/network_device.hpp"

#include <algorithm>

#include "network/bone_frame.hpp"
#include "require.hpp"
#include "session/realtime.hpp"

namespace burrlab {

constexpr double shortest_step = 1e-4, longest_step = 1.0;  // between poses [s]; else no velocity is known

NetworkDevice::NetworkDevice(const std::string& name, const std::string& host, int port, double lost_after,
                             int on_button)
    : MailboxDevice(lost_after, name),
      client_(host, port),
      server_(host + ":" + std::to_string(port)),
      on_button_(on_button) {
  if (on_button < -1 || on_button > 7) refuse("on_button", "0 to 7, or None", on_button);
}

void NetworkDevice::start(double period) {
  if (client_.stopped())
    throw InvalidArgument(name() + " must be new: its connection was closed after a session");
  MailboxDevice::start(period);
}

std::string NetworkDevice::fault() const {
  const std::string given = MailboxDevice::fault();
  return given.empty() && counters().connections == 0 ? "no server answers at " + server_ : given;
}

void NetworkDevice::stop() noexcept {
  client_.stop();
  const std::lock_guard<std::mutex> lock(stop_mutex_);  // a loop and its owner may stop it at the same time
  if (thread_.joinable()) thread_.join();
}

void NetworkDevice::run() {
  double pause = first_pause;
  while (!client_.stopped()) {
    const std::uint64_t before = counters_.messages.messages;
    buttons_ = 0;
    arrival_ = timestamp_ = 0;
    velocity_.setZero();
    has_velocity_ = false;
    if (open()) {
      ++counters_.connections;
      read_connection();
    }
    if (counters_.messages.messages > before) pause = first_pause;
    if (!client_.pause(pause)) break;
    pause = std::min(2.0 * pause, longest_pause);
  }
}

void NetworkDevice::read_connection() {
  std::uint8_t chunk[4096];
  connected_.store(true, std::memory_order_relaxed);
  publish_counters();
  for (;;) {
    bool datagram = false;
    const std::size_t size = client_.receive(chunk, sizeof chunk, -1.0, &datagram);
    if (size == 0) break;
    const bool whole = feed({chunk, size}, datagram);
    if (!whole) ++counters_.broken;
    publish_counters();
    if (!whole) break;
  }
  before_close();
  client_.close();
  after_close();
  connected_.store(false, std::memory_order_relaxed);
  publish_counters();
}

void NetworkDevice::publish_counters() {
  ReaderCounters now = counters_;
  for (std::size_t i = 0; i < openigtlink::drop_reasons; ++i)
    now.messages.dropped[i] += cutter().counters().dropped[i];
  count(now);
  const std::lock_guard<std::mutex> lock(counters_mutex_);
  published_ = now;
}

/// Whether a tick can use it; counted if not.
bool NetworkDevice::is_usable(const Vec3& vector) {
  const bool usable = openigtlink::is_plausible(vector);
  if (!usable) ++counters_.messages.dropped[std::size_t(openigtlink::Drop::out_of_range)];
  return usable;
}

void NetworkDevice::put_pose(const Vec3& position, const Quaternion& orientation, std::uint64_t timestamp,
                             bool on) {
  if (!is_usable(position)) return;
  const auto arrival = std::uint64_t(steady_now());
  if (!has_velocity_) estimate_velocity(position, timestamp, arrival);
  position_ = position;
  orientation_ = orientation;
  timestamp_ = timestamp;
  arrival_ = arrival;
  on_ = on;
  ++counters_.messages.messages;
  put_all();
}

void NetworkDevice::estimate_velocity(const Vec3& position, std::uint64_t timestamp, std::uint64_t arrival) {
  const bool stamped = timestamp_ && timestamp > timestamp_;
  const double step =
      stamped ? double(timestamp - timestamp_) / 4294967296.0 : 1e-9 * double(arrival - arrival_);
  if (arrival_ && step >= shortest_step && step <= longest_step)
    velocity_ = (position - position_) / step;
  else if (arrival_ && arrival - arrival_ > std::uint64_t(1e9 * longest_step))
    velocity_.setZero();  // two poses at the same time keep the last velocity
}

void NetworkDevice::put_velocity(const Vec3& velocity) {
  if (!is_usable(velocity)) return;
  has_velocity_ = true;
  velocity_ = velocity;
  put_all();
}

void NetworkDevice::put_buttons(std::uint32_t buttons) {
  buttons_ = buttons;
  put_all();
}

void NetworkDevice::put_all() {
  const bool on = on_button_ < 0 ? on_ : (buttons_ >> on_button_ & 1u) != 0;
  if (arrival_) put_of(arrival_, position_, velocity_, on, orientation_, std::uint8_t(buttons_));
}

}  // namespace burrlab
