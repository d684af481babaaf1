#include "burrlab/network/transform_reader.hpp"

#include <algorithm>
#include <chrono>

#include "burrlab/check.hpp"
#include "burrlab/network/bone_frame.hpp"

namespace burrlab {

using openigtlink::Drop;
using openigtlink::Message;

namespace {

constexpr double first_pause = 0.1, longest_pause = 1.0;  // [s]
constexpr std::string_view off_suffix = "_off";

std::uint64_t steady_now() {
  using namespace std::chrono;
  return std::uint64_t(duration_cast<nanoseconds>(steady_clock::now().time_since_epoch()).count());
}

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

}  // namespace

TransformReader::TransformReader(const std::string& host, int port, std::string device_name, Receive receive)
    : client_(host, port), device_name_(checked_name(std::move(device_name))), receive_(std::move(receive)) {
  thread_ = std::thread([this] { run(); });
}

void TransformReader::stop() {
  client_.stop();
  const std::lock_guard<std::mutex> lock(stop_mutex_);  // a loop and its owner may stop it at once
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
  for (int row = 0; row < 3; ++row) {
    pose.position[row] = position[row];
    for (int column = 0; column < 3; ++column) {
      const double value = transform.rotation[3 * row + column];
      pose.rotation[3 * row + column] = (row == 2) == (column == 2) ? value : 0.0 - value;
    }
  }
  pose.timestamp = message.header.timestamp;
  pose.arrival = steady_now();
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

ReaderCounters TransformReader::counters() const {
  const std::lock_guard<std::mutex> lock(counters_mutex_);
  return counters_;
}

}  // namespace burrlab
