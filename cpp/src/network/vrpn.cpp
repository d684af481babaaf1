#include "network/vrpn.hpp"

#include <cmath>

#include "require.hpp"
#include "wire.hpp"

namespace burrlab::vrpn {

using openigtlink::ByteReader;
using openigtlink::ByteWriter;
using openigtlink::get;
using openigtlink::put;

namespace {

constexpr std::string_view cookie = "vrpn: ver. 07.38  0";
constexpr std::size_t cookie_major = 14;  // characters that must agree: up to the last point
constexpr std::size_t cookie_minor = 16;  // that should
constexpr std::size_t longest_name = 99;
constexpr std::uint32_t longest_gap = 1000000;  // between numbers; a message with another one came too late
constexpr std::string_view names[named_kinds] = {
    "vrpn_Tracker Pos_Quat",  "vrpn_Tracker Velocity",  "vrpn_Button Change",    "vrpn_Button States",
    "vrpn_ForceDevice Force", "vrpn_Base ping_message", "vrpn_Base pong_message"};
constexpr std::size_t reals_of[named_kinds] = {7, 8, 0, 0, 3, 0, 0};

/// Messages begin at multiples of 8 bytes; their stated length leaves the padding out.
constexpr std::size_t padded(std::size_t size) { return (size + 7) / 8 * 8; }

/// Appends a message; `write` appends its payload.
template <class Write>
void append(Bytes& out, std::int32_t sender, std::int32_t type, std::uint64_t timestamp, Write&& write) {
  const std::size_t at = out.size();
  out.resize(at + header_size);
  ByteWriter writer(out);
  write(writer);
  const std::size_t size = out.size() - at;
  out.resize(at + padded(size));
  std::uint8_t* head = out.data() + at;
  put(head, std::uint32_t(size));
  put(head + 4, std::uint32_t(timestamp >> 32));
  put(head + 8, std::uint32_t(std::min<std::uint64_t>(((timestamp & 0xFFFFFFFF) * 1000000 + 0x80000000) >> 32,
                                                      999999)));
  put(head + 12, std::uint32_t(sender));
  put(head + 16, std::uint32_t(type));
}

void write_motion(ByteWriter& writer, const Vec3& vector, const Quaternion& q) {
  writer.number(std::uint64_t(0));  // the sensor's number, and padding
  for (const double value : {vector[0], vector[1], vector[2], q[1], q[2], q[3], q[0]}) writer.number(value);
}

void describe(Bytes& out, std::int32_t what, std::int32_t number, std::string_view name) {
  append(out, number, what, 0, [&](ByteWriter& writer) {
    writer.number(std::uint32_t(name.size() + 1)).text(name).number(std::uint8_t(0));
  });
}

}  // namespace

void encode_cookie(Bytes& out) {
  const std::size_t at = out.size();
  ByteWriter(out).text(cookie);
  out.resize(at + header_size);
}

void encode_descriptions(Bytes& out, const std::vector<std::string>& senders) {
  for (std::size_t i = 0; i < senders.size(); ++i)
    describe(out, sender_description, std::int32_t(i), senders[i]);
  for (std::size_t i = 0; i < named_kinds; ++i) describe(out, type_description, std::int32_t(i), names[i]);
}

void encode_udp(Bytes& out, const std::string& host, int port) {
  append(out, port, udp_description, 0,
         [&](ByteWriter& writer) { writer.text(host).number(std::uint8_t(0)); });
}

void encode_pose(Bytes& out, std::int32_t sender, std::uint64_t timestamp, const Vec3& position,
                 const Quaternion& orientation) {
  append(out, sender, std::int32_t(Kind::pose), timestamp,
         [&](ByteWriter& writer) { write_motion(writer, position, orientation); });
}

void encode_velocity(Bytes& out, std::int32_t sender, std::uint64_t timestamp, const Vec3& velocity,
                     const Quaternion& turn, double step) {
  append(out, sender, std::int32_t(Kind::velocity), timestamp, [&](ByteWriter& writer) {
    write_motion(writer, velocity, turn);
    writer.number(step);
  });
}

void encode_force(Bytes& out, std::int32_t sender, std::uint64_t timestamp, const Vec3& force) {
  append(out, sender, std::int32_t(Kind::force), timestamp, [&](ByteWriter& writer) {
    for (int axis = 0; axis < 3; ++axis) writer.number(force[axis]);
  });
}

void encode_pong(Bytes& out, std::int32_t sender, std::uint64_t timestamp) {
  append(out, sender, std::int32_t(Kind::pong), timestamp, [](ByteWriter&) {});
}

void number_messages(std::uint8_t* bytes, std::size_t size, std::uint32_t& next) {
  for (std::size_t at = 0; at < size; at += padded(get<std::uint32_t>(bytes + at)))
    put(bytes + at + 20, next++);
}

bool decode_name(ByteView payload, std::string_view& name) {
  std::uint32_t size = 0;
  ByteView text;
  if (!ByteReader(payload).number(size).rest(text).ok() || text.size != size) return false;
  name = {reinterpret_cast<const char*>(text.data), size};
  return true;
}

Kind kind_of_type(std::string_view name) {
  const auto* at = std::find(names, names + named_kinds, name);
  return at < names + named_kinds ? Kind(at - names) : Kind::none;
}

bool is_pressed(ByteView states, std::size_t button) {
  return 4 * button + 4 <= states.size && get<std::uint32_t>(states.data + 4 * button) != 0;
}

Drop decode_payload(Kind kind, ByteView payload, Message& message) {
  std::uint32_t pressed = 0;
  ByteView padding;
  ByteReader reader(payload);
  if (kind >= Kind::ping) return Drop::none;
  if (kind != Kind::force) reader.number(message.number);
  if (kind == Kind::button) {
    if (!reader.number(pressed).ended()) return Drop::bad_length;
    message.pressed = pressed != 0;
    return Drop::none;
  }
  if (kind == Kind::buttons) {
    const bool whole = reader.rest(message.states).ok() &&
                       message.states.size == 4 * std::uint64_t(std::uint32_t(message.number));
    return whole ? Drop::none : Drop::bad_length;
  }
  if (kind != Kind::force) reader.bytes(4, padding);
  bool finite = true;
  for (std::size_t i = 0; i < reals_of[std::size_t(kind)]; ++i) {
    reader.number(message.values[i]);
    finite = finite && std::isfinite(message.values[i]);
  }
  if (!reader.ended()) return Drop::bad_length;
  return finite ? Drop::none : Drop::not_finite;
}

Reader::Reader(std::vector<std::string> senders, std::size_t largest_payload)
    : StreamCutter(header_size, padded(largest_payload)),  // with its padding
      senders_(std::move(senders)) {
  restart();
}

void Reader::restart() {
  StreamCutter::restart();
  kind_of_.assign(most_numbers, std::uint8_t(Kind::none));
  sender_of_.assign(most_numbers, 0);
  greeted_ = numbered_ = false;
}

bool Reader::decode_head(ByteView bytes, Head& head, std::size_t largest) {
  ByteReader(bytes)
      .number(head.size)
      .number(head.seconds)
      .number(head.microseconds)
      .number(head.sender)
      .number(head.type)
      .number(head.sequence);
  return head.size >= header_size && head.size - header_size <= largest;
}

void Reader::begin_message(ByteView bytes, const Receive& receive) {
  if (!greeted_) {
    const std::string_view text(reinterpret_cast<const char*>(bytes.data), cookie.size());
    Message message;
    message.kind = Kind::cookie;
    message.text = text;
    message.number = text.substr(0, cookie_minor) != cookie.substr(0, cookie_minor);
    greeted_ = text.substr(0, cookie_major) == cookie.substr(0, cookie_major);
    if (!greeted_) break_off(Drop::bad_version);
    receive(message);
  } else if (!decode_head(bytes, head_, largest_body())) {
    break_off(Drop::implausible_size);
  } else {
    await_body(padded(head_.size) - header_size);
  }
}

bool Reader::feed(ByteView bytes, const Receive& receive) {
  return cut(
      bytes, [&](ByteView head) { begin_message(head, receive); },
      [&](ByteView body) { finish(head_, body, receive); });
}

void Reader::feed_datagram(ByteView bytes, const Receive& receive) {
  Head head;
  while (greeted_ && bytes.size > 0) {
    if (bytes.size < header_size || !decode_head(bytes, head, bytes.size - header_size) ||
        padded(head.size) > bytes.size)
      return count_drop(Drop::truncated);
    const std::uint32_t gap = head.sequence - next_;
    if (numbered_ && gap < longest_gap) lost_ += gap;
    if (!numbered_ || gap < longest_gap) next_ = head.sequence + 1;
    numbered_ = true;
    finish(head, {bytes.data + header_size, padded(head.size) - header_size}, receive);
    bytes = {bytes.data + padded(head.size), bytes.size - padded(head.size)};
  }
}

void Reader::finish(const Head& head, ByteView body, const Receive& receive) {
  Message message;
  message.timestamp = openigtlink::timestamp_of(head.seconds, std::min(head.microseconds, 999999u) * 1000);
  const Drop reason = decode(head, {body.data, head.size - header_size}, message);
  if (reason != Drop::none) return count_drop(reason);
  if (message.kind == Kind::none) return;
  ++counters_.messages;
  receive(message);
}

/// A sender's or a type's name.
Drop Reader::describe(const Head& head, ByteView payload, Message& message) {
  std::string_view name;
  if (!decode_name(payload, name) || name.empty() || name.back() != 0 || name.size() > longest_name + 1 ||
      head.sender < 0 || std::size_t(head.sender) >= most_numbers)
    return Drop::bad_length;
  message.text = name.substr(0, name.size() - 1);
  if (head.type == type_description) {
    kind_of_[std::size_t(head.sender)] = std::uint8_t(kind_of_type(message.text));
    return Drop::none;
  }
  message.kind = Kind::sender;
  const auto at = std::find(senders_.begin(), senders_.end(), message.text);
  sender_of_[std::size_t(head.sender)] = std::uint8_t(at == senders_.end() ? 0 : 1 + (at - senders_.begin()));
  return Drop::none;
}

Drop Reader::decode(const Head& head, ByteView payload, Message& message) {
  if (head.type == sender_description || head.type == type_description)
    return describe(head, payload, message);
  if (head.type == udp_description) {
    message.number = head.sender;
    if (head.sender < 1 || head.sender > 65535) return Drop::out_of_range;
    message.kind = Kind::udp;
  }
  if (head.type < 0) return Drop::none;  // log files, and those to come
  if (std::size_t(head.type) >= most_numbers ||
      kind_of_[std::size_t(head.type)] == std::uint8_t(Kind::none)) {
    ++other_type_;
    return Drop::none;
  }
  if (head.sender < 0 || std::size_t(head.sender) >= most_numbers || !sender_of_[std::size_t(head.sender)]) {
    ++other_sender_;
    return Drop::none;
  }
  message.kind = Kind(kind_of_[std::size_t(head.type)]);
  message.sender = std::size_t(sender_of_[std::size_t(head.sender)] - 1);
  return decode_payload(message.kind, payload, message);
}

}  // namespace burrlab::vrpn
