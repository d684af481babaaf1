// VRPN messages, version 07: those of a Tracker, a Button and a ForceDevice, and what a connection needs. The
// wire format is that of github.com/vrpn/vrpn, vrpn_Connection.C; big-endian, in metres and newton.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "burrlab/types.hpp"
#include "network/message_framer.hpp"
#include "quaternion.hpp"

namespace burrlab::vrpn {

using openigtlink::Bytes;
using openigtlink::ByteView;
using openigtlink::Drop;

constexpr int default_port = 3883;
constexpr std::size_t header_size = 24;  // a cookie, with which each side begins, is as long
constexpr std::size_t pose_size = header_size + 64, velocity_size = header_size + 72;  // of messages [bytes]
constexpr std::size_t force_size = header_size + 24;
/// Types that give a number its name, and the one that tells a UDP port.
constexpr std::int32_t sender_description = -1, type_description = -2, udp_description = -3;

/// What a message is. The first are types by name; ours have the number of their place, from 0.
enum class Kind : std::uint8_t {
  pose,
  velocity,
  button,
  buttons,
  force,
  ping,
  pong,
  cookie,
  sender,
  udp,
  none
};
constexpr std::size_t named_kinds = std::size_t(Kind::cookie);

/// An intact message. The text is a view into the reader's buffer.
struct Message {
  Kind kind = Kind::none;
  std::size_t sender = 0;          ///< place in the reader's `senders`
  std::int32_t number = 0;         ///< sensor, button, UDP port; of a cookie: 1 if its version is not ours
  bool pressed = false;            ///< of a button
  ByteView states;                 ///< of `buttons`: of each an int32, not 0 if it is pressed
  std::array<double, 8> values{};  ///< position [m] or velocity [m/s], x, y, z, w, time step [s]; force [N]
  std::uint64_t timestamp = 0;     ///< 32.32 fixed point [s]
  std::string_view text;           ///< a sender's name, or a cookie
};

/// Reads the payload of a message of this kind into `message`: number, states, values. Drop::none, or why it
/// is damaged.
Drop decode_payload(Kind kind, ByteView payload, Message& message);
/// The text of a sender's or a type's description; false if it is damaged.
bool decode_name(ByteView payload, std::string_view& name);
/// The kind of a type with this name, Kind::none if it is not one of ours.
Kind kind_of_type(std::string_view name);
/// Whether button i is pressed, by `Message::states`; not beyond their end.
bool is_pressed(ByteView states, std::size_t button);

/// Reads what one peer sends: its cookie, then messages. The peer describes its senders and types by name
/// before it uses their numbers. Messages of other senders and of other types are passed over.
class Reader : public openigtlink::StreamCutter {
 public:
  using Receive = std::function<void(const Message&)>;  ///< must not throw

  explicit Reader(std::vector<std::string> senders, std::size_t largest_payload = 65536);

  /// Bytes of the TCP connection; false if the stream is broken: a cookie of another version, or a message
  /// that cannot be.
  bool feed(ByteView bytes, const Receive& receive);
  /// One UDP packet, of whole messages; what is left of a broken one is dropped.
  void feed_datagram(ByteView bytes, const Receive& receive);
  void restart();                            ///< for a new connection
  bool greeted() const { return greeted_; }  ///< its cookie has come
  std::uint64_t other_type() const { return other_type_; }
  std::uint64_t other_sender() const { return other_sender_; }
  /// Messages over UDP that did not come, or came too late, by the numbers of the others.
  std::uint64_t lost() const { return lost_; }

 private:
  static constexpr std::size_t most_numbers = 2000;  // as VRPN has
  struct Head {
    std::uint32_t size = 0, seconds = 0, microseconds = 0;
    std::int32_t sender = 0, type = 0;
    std::uint32_t sequence = 0;
  };

  static bool decode_head(ByteView bytes, Head& head, std::size_t largest);
  void begin_message(ByteView bytes, const Receive& receive);
  void finish(const Head& head, ByteView body, const Receive& receive);
  Drop describe(const Head& head, ByteView payload, Message& message);
  Drop decode(const Head& head, ByteView payload, Message& message);

  std::vector<std::string> senders_;
  std::vector<std::uint8_t> kind_of_, sender_of_;  // by the peer's numbers; sender_of_ from 1, 0 is another
  bool greeted_ = false, numbered_ = false;
  std::uint32_t next_ = 0;  // number of the next message over UDP
  Head head_;
  std::uint64_t other_type_ = 0, other_sender_ = 0, lost_ = 0;
};

// Each appends a whole message to `out`. `sender` is our number of it.
void encode_cookie(Bytes& out);
/// Names our senders, and our types: those of `Kind`.
void encode_descriptions(Bytes& out, const std::vector<std::string>& senders);
void encode_udp(Bytes& out, const std::string& host, int port);  ///< where UDP packets are awaited
void encode_pose(Bytes& out, std::int32_t sender, std::uint64_t timestamp, const Vec3& position,
                 const Quaternion& orientation);  ///< [m]; w, x, y, z
/// `turn` is the rotation within `step` [s].
void encode_velocity(Bytes& out, std::int32_t sender, std::uint64_t timestamp, const Vec3& velocity,
                     const Quaternion& turn, double step);
void encode_force(Bytes& out, std::int32_t sender, std::uint64_t timestamp, const Vec3& force);
void encode_pong(Bytes& out, std::int32_t sender, std::uint64_t timestamp);
/// Numbers the whole messages of `bytes` from `next` on.
void number_messages(std::uint8_t* bytes, std::size_t size, std::uint32_t& next);

}  // namespace burrlab::vrpn
