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

/// Time from one pose to the next [s]; 0 if unknown.
double step_between(const NetworkPose& last, const NetworkPose& next) {
  const bool stamped = last.timestamp && next.timestamp > last.timestamp;
  const double step = stamped ? double(next.timestamp - last.timestamp) / 4294967296.0
                              : 1e-9 * double(next.arrival - last.arrival);
  return step >= shortest_step && step <= longest_step ? step : 0.0;
}

}  // namespace

TransformReader::TransformReader(const std::string& host, int port, std::string device_name, Receive receive)
    : client_(host, port), device_name_(checked_name(std::move(device_name))), receive_(std::move(receive)) {
  thread_ = std::thread([this] { run(); });
}

void TransformReader::stop() {
  client_.stop();
  const std::lock_guard<std::mutex> lock(stop_mutex_);  // a loop and its owner may stop it at the same time
  if (thread_.joinable()) thread_.join();
}

void TransformReader::run() {
  double pause = first_pause;
  while (!client_.stopped()) {
    const std::uint64_t before = accepted_;
    if (client_.connect()) {
      ++connections_;
      read_connection();
    }
    if (accepted_ > before) pause = first_pause;
    if (!client_.pause(pause)) break;
    pause = std::min(2.0 * pause, longest_pause);
  }
}

void TransformReader::read_connection() {
  std::uint8_t chunk[4096];
  connected_.store(true, std::memory_order_relaxed);
  publish_counters();
  const openigtlink::MessageFramer::Receive receive = [this](const Message& message) { take(message); };
  bool whole = true;
  while (whole) {
    const std::size_t size = client_.receive(chunk, sizeof chunk);
    if (size == 0) break;
    whole = framer_.feed({chunk, size}, receive);
    publish_counters();
  }
  if (!whole) ++broken_;
  client_.close();
  framer_.restart();
  connected_.store(false, std::memory_order_relaxed);
  publish_counters();
}

void TransformReader::take(const Message& message) {
  openigtlink::Transform transform;
  Drop reason = decode_transform(message, transform);
  if (reason == Drop::wrong_type) {
    ++other_type_;
    return;
  }
  const auto [name, on] = split_switch(message.header.device_name.view());
  if (!device_name_.empty() && name != split_switch(device_name_).first) {
    ++other_device_;
    return;
  }
  const Vec3 position = openigtlink::position_from_ras(transform);
  if (reason == Drop::none && !openigtlink::is_plausible(position)) reason = Drop::out_of_range;
  if (reason != Drop::none) {
    ++refused_[std::size_t(reason)];
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
  pose.count = ++accepted_;
  pose.on = on;
  newest_.put(pose);
  if (receive_) receive_(pose);
}

void TransformReader::publish_counters() {
  ReaderCounters now{framer_.counters(), other_type_, other_device_, connections_, broken_};
  now.messages.messages = accepted_;
  for (std::size_t i = 0; i < refused_.size(); ++i) now.messages.dropped[i] += refused_[i];
  const std::lock_guard<std::mutex> lock(counters_mutex_);
  counters_ = now;
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
  const double step = last_.count ? step_between(last_, pose) : 0.0;
  if (step > 0.0)
    velocity_ = (position - Vec3(last_.position[0], last_.position[1], last_.position[2])) / step;
  else if (last_.count && pose.arrival - last_.arrival > std::uint64_t(1e9 * longest_step))
    velocity_.setZero();  // two poses at the same time keep the last velocity
  last_ = pose;
  Quaternion orientation{1.0, 0.0, 0.0, 0.0};
  to_quaternion(Eigen::Map<const RotationRows>(pose.rotation.data()), orientation);  // 1 if it is none
  put(position, velocity_, pose.on != 0, orientation);
}

}  // namespace burrlab
