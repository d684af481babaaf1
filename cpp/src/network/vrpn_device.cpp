#include "network/bone_frame.hpp"
#include "network/network_device.hpp"

namespace burrlab {

using openigtlink::Drop;

constexpr std::size_t longest_list = 300;  // of senders, in a sentence [bytes]

static std::string checked_tracker(const std::string& name) {
  if (name.empty() || name.size() > 99) refuse("length of name", "1 to 99 bytes", double(name.size()));
  return name;
}

static std::string printable(std::string_view text) {
  std::string out(text);
  for (char& c : out)
    if (c < ' ' || c > '~') c = '?';
  return out;
}

VrpnDevice::VrpnDevice(const std::string& name, const std::string& host, const VrpnSettings& settings)
    : NetworkDevice(
          "vrpn:" + name + "@" + (settings.tcp ? "tcp://" : "") + host + ":" + std::to_string(settings.port),
          host, settings.port, settings.lost_after, settings.on_button),
      settings_(settings),
      tracker_(checked_tracker(name)),
      reader_({name}) {
  start_thread();
}

void VrpnDevice::set_fault(const std::string& fault) {
  const std::lock_guard<std::mutex> lock(fault_mutex_);
  fault_ = fault;
}

std::string VrpnDevice::fault() const {
  const std::lock_guard<std::mutex> lock(fault_mutex_);
  if (fault_.empty() && connected() && !has_tracker_ && !senders_.empty())
    return server_ + " has no sender '" + tracker_ + "', it has " + senders_;
  return fault_.empty() ? NetworkDevice::fault() : fault_;
}

bool VrpnDevice::open() {
  {
    const std::lock_guard<std::mutex> lock(fault_mutex_);
    senders_.clear();
    has_tracker_ = false;
  }
  newest_ = 0;
  if (!(settings_.tcp ? client_.connect() : client_.ask_for_connection())) return false;
  vrpn::Bytes hello;
  vrpn::encode_cookie(hello);
  std::string address;
  const int port = settings_.tcp ? 0 : client_.open_datagrams(address);
  if (port) vrpn::encode_udp(hello, address, port);
  return client_.send(hello.data(), hello.size());
}

bool VrpnDevice::feed(openigtlink::ByteView bytes, bool datagram) {
  const auto refused = reader_.counters()[Drop::not_finite];
  const vrpn::Reader::Receive receive = [&](const vrpn::Message& message) { take(message); };
  if (datagram) {
    ++counters_.datagrams;
    reader_.feed_datagram(bytes, receive);
  } else if (!reader_.feed(bytes, receive)) {
    if (reader_.greeted()) set_fault(server_ + " sent a message whose length cannot be");
    return false;
  }
  if (reader_.counters()[Drop::not_finite] > refused)
    set_fault("a message of '" + tracker_ + "' is not finite");
  return true;
}

void VrpnDevice::after_close() {
  const auto before = reader_.counters()[Drop::truncated];
  const bool broken = reader_.broken();
  reader_.restart();
  const bool within = reader_.counters()[Drop::truncated] > before;
  if (!broken && !client_.stopped())
    set_fault("the connection to " + server_ + " ended" + (within ? " within a message" : ""));
}

void VrpnDevice::count(ReaderCounters& counters) const {
  counters.other_type = reader_.other_type();
  counters.other_device = reader_.other_sender();
  counters.lost = reader_.lost();
}

void VrpnDevice::take(const vrpn::Message& message) {
  using vrpn::Kind;
  switch (message.kind) {
    case Kind::cookie:
      if (!reader_.greeted())
        return set_fault(server_ + " must be a VRPN server of version 07, it says '" +
                         printable(message.text) + "'");
      set_fault("");
      if (message.number && note_.empty()) {  // only this thread writes it
        const std::lock_guard<std::mutex> lock(fault_mutex_);
        note_ = server_ + " says '" + printable(message.text) + "', its minor version is not 38";
      }
      return;
    case Kind::sender: {
      const std::lock_guard<std::mutex> lock(fault_mutex_);
      has_tracker_ = has_tracker_ || message.text == tracker_;
      if (message.text != "VRPN Control" && senders_.size() < longest_list)
        senders_ += (senders_.empty() ? "" : ", ") + printable(message.text);
      return;
    }
    case Kind::pose:
      return take_pose(message);
    case Kind::velocity:
      if (message.number == 0) put_velocity(1e3 * Vec3(message.values.data()));
      return;
    case Kind::button:
      if (message.number >= 0 && message.number <= 7)
        put_buttons((buttons() & ~(1u << message.number)) | std::uint32_t(message.pressed) << message.number);
      return;
    case Kind::buttons: {
      std::uint32_t pressed = 0;
      for (std::size_t i = 0; i < 8; ++i) pressed |= std::uint32_t(vrpn::is_pressed(message.states, i)) << i;
      return put_buttons(pressed);
    }
    default:
      return;
  }
}

void VrpnDevice::take_pose(const vrpn::Message& message) {
  if (message.number != 0) return;
  const bool older = !settings_.tcp && message.timestamp < newest_;
  if (older && newest_ - message.timestamp < std::uint64_t(1) << 32) return;  // overtaken on UDP
  newest_ = message.timestamp;
  const auto& v = message.values;
  const Eigen::Quaterniond q(v[6], v[3], v[4], v[5]);
  const bool is_rotation = std::abs(q.norm() - 1.0) <= 1e-2;
  const Eigen::Quaterniond unit = is_rotation ? q.normalized() : Eigen::Quaterniond::Identity();
  const double sign = unit.w() < 0.0 ? -1.0 : 1.0;
  if (!fault_.empty()) set_fault("");  // only this thread writes it
  put_pose(1e3 * Vec3(v.data()), {sign * unit.w(), sign * unit.x(), sign * unit.y(), sign * unit.z()},
           message.timestamp, true);
}

}  // namespace burrlab
