#include "burrlab/network/transform_reader.hpp"

#include <algorithm>

#include "burrlab/check.hpp"
#include "burrlab/network/bone_frame.hpp"
#include "burrlab/session/realtime.hpp"

namespace burrlab {

using openigtlink::Drop;
using openigtlink::Message;

namespace {

constexpr std::string_view off_suffix = "_off";

/// The name without "_off", and whether the burr is on.
std::pair<std::string_view, bool> split_switch(std::string_view name) {
  const bool off =
      name.size() >= off_suffix.size() && name.substr(name.size() - off_suffix.size()) == off_suffix;
  return {off ? name.substr(0, name.size() - off_suffix.size()) : name, !off};
}

std::string checked_name(std::string name) {
  if (name.size() > openigtlink::device_name_size)
    refuse("length of device_name", "at most 20 bytes", double(name.size()));
  return name;
}

constexpr double shortest_step = 1e-4, longest_step = 1.0;  // between poses [s]; else no velocity is known

}  // namespace

void StreamReader::begin() {
  thread_ = std::thread([this] { run(); });
}

void StreamReader::stop() {
  client_.stop();
  const std::lock_guard<std::mutex> lock(stop_mutex_);  // a loop and its owner may stop it at the same time
  if (thread_.joinable()) thread_.join();
}

void StreamReader::run() {
  double pause = first_pause;
  while (!client_.stopped()) {
    const std::uint64_t before = counters_.messages.messages;
    if (open()) {
      ++counters_.connections;
      read_connection();
    }
    if (counters_.messages.messages > before) pause = first_pause;
    if (!client_.pause(pause)) break;
    pause = std::min(2.0 * pause, longest_pause);
  }
}

void StreamReader::read_connection() {
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
  client_.close();
  restart();
  connected_.store(false, std::memory_order_relaxed);
  publish_counters();
}

void StreamReader::publish_counters() {
  ReaderCounters now = counters_;
  count(now);
  const std::lock_guard<std::mutex> lock(counters_mutex_);
  published_ = now;
}

const Vec3& VelocityEstimate::next(const Vec3& position, std::uint64_t timestamp, std::uint64_t arrival) {
  const bool stamped = timestamp_ && timestamp > timestamp_;
  const double step =
      stamped ? double(timestamp - timestamp_) / 4294967296.0 : 1e-9 * double(arrival - arrival_);
  if (arrival_ && step >= shortest_step && step <= longest_step)
    velocity_ = (position - position_) / step;
  else if (arrival_ && arrival - arrival_ > std::uint64_t(1e9 * longest_step))
    velocity_.setZero();  // two poses at the same time keep the last velocity
  position_ = position;
  timestamp_ = timestamp;
  arrival_ = arrival;
  return velocity_;
}

TransformReader::TransformReader(const std::string& host, int port, std::string device_name, Receive receive)
    : StreamReader(host, port),
      device_name_(checked_name(std::move(device_name))),
      receive_(std::move(receive)) {
  begin();
}

void TransformReader::take(const Message& message) {
  openigtlink::Transform transform;
  Drop reason = decode_transform(message, transform);
  if (reason == Drop::wrong_type) {
    ++counters_.other_type;
    return;
  }
  const auto [name, on] = split_switch(message.header.device_name.view());
  if (!device_name_.empty() && name != split_switch(device_name_).first) {
    ++counters_.other_device;
    return;
  }
  const Vec3 position = openigtlink::position_from_ras(transform);
  if (reason == Drop::none && !openigtlink::is_plausible(position)) reason = Drop::out_of_range;
  if (reason != Drop::none) {
    ++counters_.messages.dropped[std::size_t(reason)];
    return;
  }
  NetworkPose pose{};
  RotationRows rotation;
  std::copy_n(transform.rotation.begin(), 9, rotation.data());
  rotation = openigtlink::turned(rotation);
  std::copy_n(rotation.data(), 9, pose.rotation.begin());
  for (int axis = 0; axis < 3; ++axis) pose.position[axis] = position[axis];
  pose.timestamp = message.header.timestamp;
  pose.arrival = std::uint64_t(steady_now());
  pose.count = ++counters_.messages.messages;
  pose.on = on;
  newest_.put(pose);
  if (receive_) receive_(pose);
}

void TransformReader::count(ReaderCounters& counters) const {
  for (std::size_t i = 0; i < openigtlink::drop_reasons; ++i)
    counters.messages.dropped[i] += framer_.counters().dropped[i];
}

IgtlDevice::IgtlDevice(const std::string& host, int port, const std::string& device_name, double lost_after)
    : MailboxDevice(lost_after, "igtl:" + host + ":" + std::to_string(port)),
      reader_(host, port, device_name, [this](const NetworkPose& pose) { take(pose); }) {}

void IgtlDevice::start(double period) {
  if (reader_.stopped())
    throw std::invalid_argument("IgtlDevice must be new: its connection was closed after a session");
  MailboxDevice::start(period);
}

void IgtlDevice::take(const NetworkPose& pose) {
  const Vec3 position(pose.position[0], pose.position[1], pose.position[2]);
  Quaternion orientation{1.0, 0.0, 0.0, 0.0};
  to_quaternion(Eigen::Map<const RotationRows>(pose.rotation.data()), orientation);  // 1 if it is none
  put(position, velocity_.next(position, pose.timestamp, pose.arrival), pose.on != 0, orientation);
}

}  // namespace burrlab
