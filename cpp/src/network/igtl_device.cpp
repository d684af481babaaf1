#include "network/bone_frame.hpp"
#include "network/network_device.hpp"
#include "require.hpp"

namespace burrlab {

using openigtlink::Drop;
using openigtlink::Message;

namespace {

constexpr std::string_view off_suffix = "_off", stylus_name = "Stylus";

/// The name without "_off", and whether the burr is on.
std::pair<std::string_view, bool> split_switch(std::string_view name) {
  const bool off =
      name.size() >= off_suffix.size() && name.substr(name.size() - off_suffix.size()) == off_suffix;
  return {off ? name.substr(0, name.size() - off_suffix.size()) : name, !off};
}

/// What stands before "To" and a capital, as PLUS names transforms.
std::string_view tool_of(std::string_view name) {
  const std::size_t to = name.find("To");
  const bool framed = to != name.npos && to + 2 < name.size() && name[to + 2] >= 'A' && name[to + 2] <= 'Z';
  return framed ? name.substr(0, to) : name;
}

std::string checked_name(std::string name) {
  if (name.size() > openigtlink::device_name_size)
    refuse("length of device_name", "at most 20 bytes", double(name.size()));
  return name;
}

}  // namespace

IgtlDevice::IgtlDevice(const std::string& host, int port, const std::string& device_name, double lost_after,
                       int on_button)
    : NetworkDevice("igtl:" + host + ":" + std::to_string(port), host, port, lost_after, on_button),
      device_name_(checked_name(device_name)) {
  start_thread();
}

void IgtlDevice::take(const Message& message) {
  openigtlink::Transform transform;
  const Drop reason = decode_transform(message, transform);
  if (reason == Drop::wrong_type) {
    ++counters_.other_type;
    return;
  }
  const auto [name, on] = split_switch(message.header.device_name.view());
  const std::string_view wanted = stylus_.empty() ? split_switch(device_name_).first : stylus_;
  const std::string_view tool = tool_of(name);
  const bool stylus = tool == stylus_name;
  const bool beside = name != wanted && (wanted.empty() || tool_of(wanted) == stylus_name) &&
                      (tool == "StylusVelocity" || tool == "Buttons");
  const bool a_force = wanted.empty() && (tool == "Force" || tool == "Force_1");
  if (a_force || (!beside && !wanted.empty() && name != wanted)) {
    ++counters_.other_device;
    return;
  }
  if (reason != Drop::none) {
    ++counters_.messages.dropped[std::size_t(reason)];
    return;
  }
  const Vec3 translation = openigtlink::position_from_ras(transform);
  RotationRows rotation;
  std::copy_n(transform.rotation.begin(), 9, rotation.data());
  if (beside && tool == "Buttons") {
    std::uint32_t buttons = 0;
    for (int row = 0; row < 3; ++row) buttons |= std::uint32_t(rotation(row, 0) != 0.0) << row;
    return put_buttons(buttons);
  }
  if (beside) return put_velocity(translation);
  Quaternion orientation{1.0, 0.0, 0.0, 0.0};
  to_quaternion(openigtlink::turned(rotation), orientation);  // 1 if it is none
  put_pose(translation, orientation, message.header.timestamp, on);
  if (!stylus) return;
  stylus_ = name;
  force_version_ = message.header.version;
  if (unsent_.empty()) encode_force(force());
  const std::size_t sent = client_.send_some(unsent_.data(), unsent_.size());
  unsent_.erase(unsent_.begin(), unsent_.begin() + std::ptrdiff_t(sent));
}

void IgtlDevice::encode_force(const Vec3& force) {
  const std::string name = "Force" + stylus_.substr(stylus_name.size());
  encode_transform(unsent_, {name, openigtlink::timestamp_now(), force_version_}, openigtlink::to_ras(force));
}

void IgtlDevice::before_close() {
  if (stylus_.empty()) return;
  encode_force(Vec3::Zero());
  client_.close_after(unsent_.data(), unsent_.size());
  unsent_.clear();
  stylus_.clear();
}

}  // namespace burrlab
