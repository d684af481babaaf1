#include "burrlab/network/replica_protocol.hpp"

#include <algorithm>
#include <cmath>

#include "burrlab/check.hpp"
#include "wire.hpp"

namespace burrlab::replica_protocol {

using openigtlink::ByteReader;
using openigtlink::Bytes;
using openigtlink::ByteView;
using openigtlink::ByteWriter;
using openigtlink::Drop;
using openigtlink::Message;

namespace {

constexpr std::string_view names[] = {"",
                                      "burrlab_replica",
                                      "burrlab_hello",
                                      "burrlab_tick",
                                      "burrlab_digest",
                                      "burrlab_bricks",
                                      "burrlab_idle",
                                      "burrlab_end"};
constexpr std::size_t tick_head = 5, tick_burr = 16;  // numbers

openigtlink::Envelope envelope(Kind kind, int header_version) {
  openigtlink::Envelope envelope;
  envelope.device_name = names[std::size_t(kind)];
  envelope.timestamp = openigtlink::timestamp_now();
  envelope.version = header_version;
  return envelope;
}

template <class Write>
void append(Bytes& out, Kind kind, int header_version, Write&& write) {
  Bytes content;
  ByteWriter writer(content);
  write(writer);
  openigtlink::encode_ndarray_uint8(out, envelope(kind, header_version), {content.data(), content.size()});
}

/// Has no first number if the message is no intact one of this kind.
ByteReader open(const Message& message, Kind kind) {
  ByteView bytes;
  if (kind_of(message) == kind) openigtlink::decode_ndarray_uint8(message, bytes);
  return ByteReader(bytes);
}

bool is_digest(const std::string& text) {
  return text.find_first_not_of("0123456789abcdef") == std::string::npos;
}

/// A whole number from 0 to `most`; false if it is none.
template <class Integer>
bool whole(double value, double most, Integer& integer) {
  if (!(value >= 0.0 && value <= most && std::floor(value) == value)) return false;
  integer = Integer(value);
  return true;
}

}  // namespace

Kind kind_of(const Message& message) {
  const std::string_view name = message.header.device_name.view();
  for (std::size_t kind = 1; kind < std::size(names); ++kind)
    if (name == names[kind]) return Kind(kind);
  return Kind::other;
}

void encode(Bytes& out, int header_version, const Word& word) {
  append(out, Kind::word, header_version, [&](ByteWriter& writer) {
    writer.number(version).number(std::uint32_t(word.holds)).number(word.session);
    writer.number(word.tick).text(word.digest);
  });
}

bool decode(const Message& message, Word& word) {
  std::uint32_t theirs = 0, holds = 0;
  ByteReader reader = open(message, Kind::word);
  reader.number(theirs).number(holds).number(word.session).number(word.tick).text(digest_digits, word.digest);
  word.holds = Holds(holds);
  return reader.ended() && theirs == version && holds <= std::uint32_t(Holds::all);
}

void encode(Bytes& out, int header_version, const Hello& hello) {
  append(out, Kind::hello, header_version, [&](ByteWriter& writer) {
    writer.number(hello.version).number(hello.session).number(hello.first_tick);
    writer.text(hello.digest).text(hello.text);
  });
}

bool decode(const Message& message, Hello& hello) {
  ByteReader reader = open(message, Kind::hello);
  reader.number(hello.version).number(hello.session).number(hello.first_tick);
  reader.text(digest_digits, hello.digest).rest(hello.text);
  return reader.ended() && hello.session != 0 && is_digest(hello.digest);
}

void encode(Bytes& out, int header_version, const TickMessage& tick) {
  const TickRecord& record = tick.record;
  double values[tick_head + tick_burr * most_burrs] = {
      double(record.index), double(record.k), double(record.burrs), record.time, double(tick.digest_tick)};
  double* at = values + tick_head;
  for (std::uint32_t i = 0; i < std::min<std::uint32_t>(record.burrs, most_burrs); ++i) {
    const BurrRecord& burr = record.burr[i];
    for (const double c : burr.center) *at++ = c;
    *at++ = burr.radius;
    *at++ = double(burr.material);
    *at++ = double(burr.on);
    for (const double f : burr.force) *at++ = f;
    *at++ = burr.penetration;
    *at++ = double(burr.removed);
    for (const double q : burr.orientation) *at++ = q;
    *at++ = double(burr.buttons);
  }
  openigtlink::encode_ndarray_float64(out, envelope(Kind::tick, header_version), values,
                                      std::size_t(at - values));
}

bool decode(const Message& message, TickMessage& tick) {
  if (kind_of(message) != Kind::tick) return false;
  openigtlink::Ndarray array;
  if (openigtlink::decode_ndarray_float64(message, array) != Drop::none) return false;
  const std::vector<double>& values = array.values;
  TickRecord& record = tick.record;
  record = TickRecord{};
  if (values.size() < tick_head) return false;
  if (!whole(values[0], double(exact), record.index) || !whole(values[1], most_periods, record.k) ||
      !whole(values[2], most_burrs, record.burrs) || !whole(values[4], double(exact), tick.digest_tick))
    return false;
  record.time = values[3];
  if (record.k < 1 || record.burrs < 1 || values.size() != tick_head + tick_burr * record.burrs) return false;
  const double* at = values.data() + tick_head;
  for (std::uint32_t i = 0; i < record.burrs; ++i) {
    BurrRecord& burr = record.burr[i];
    for (double& c : burr.center)
      if (!std::isfinite(c = *at++)) return false;
    burr.radius = *at++;
    if (!whole(*at++, 4294967295.0, burr.material) || !whole(*at++, 1.0, burr.on)) return false;
    for (double& f : burr.force) f = *at++;
    burr.penetration = *at++;
    if (!whole(*at++, double(exact), burr.removed)) return false;
    for (double& q : burr.orientation)
      if (!std::isfinite(q = *at++)) return false;
    if (!whole(*at++, 255.0, burr.buttons)) return false;
  }
  return true;
}

void encode(Bytes& out, int header_version, const Digest& digest) {
  append(out, Kind::digest, header_version,
         [&](ByteWriter& writer) { writer.number(digest.tick).text(digest.digest); });
}

bool decode(const Message& message, Digest& digest) {
  return open(message, Kind::digest).number(digest.tick).text(digest_digits, digest.digest).ended();
}

void encode(Bytes& out, int header_version, const Bricks& bricks) {
  append(out, Kind::bricks, header_version, [&](ByteWriter& writer) {
    writer.number(bricks.tick).text(bricks.digest).number(bricks.total).number(bricks.first);
    writer.bytes(bricks.bricks.data, bricks.bricks.size);
  });
}

bool decode(const Message& message, Bricks& bricks) {
  ByteReader reader = open(message, Kind::bricks);
  reader.number(bricks.tick).text(digest_digits, bricks.digest).number(bricks.total).number(bricks.first);
  if (!reader.ok() || reader.left() % brick_bytes) return false;
  const std::size_t here = reader.left() / brick_bytes;
  reader.bytes(reader.left(), bricks.bricks);
  return bricks.first <= bricks.total && here <= bricks.total - bricks.first &&
         (here > 0 || bricks.total == 0);
}

void encode(Bytes& out, int header_version, const Idle& idle) {
  append(out, Kind::idle, header_version, [&](ByteWriter& writer) { writer.number(idle.tick); });
}

bool decode(const Message& message, Idle& idle) {
  return open(message, Kind::idle).number(idle.tick).ended();
}

void encode(Bytes& out, int header_version, const End& end) {
  append(out, Kind::end, header_version, [&](ByteWriter& writer) {
    writer.number(end.tick).text(end.digest).number(end.failed).text(end.reason);
  });
}

bool decode(const Message& message, End& end) {
  ByteReader reader = open(message, Kind::end);
  reader.number(end.tick).text(digest_digits, end.digest).number(end.failed).rest(end.reason);
  return reader.ended() && end.failed <= 1;
}

}  // namespace burrlab::replica_protocol
