#include "network/replica_protocol.hpp"

#include <algorithm>
#include <cmath>

#include "require.hpp"
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
  return {names[std::size_t(kind)], openigtlink::timestamp_now(), header_version};
}

// The fields of each message in their order, for a writer or a reader.
template <class Stream>
void pass_fields(Stream& stream, Word& word) {
  stream.number(word.version).number(word.holds).number(word.session).number(word.tick);
  stream.text(word.digest, digest_digits);
}

template <class Stream>
void pass_fields(Stream& stream, Hello& hello) {
  stream.number(hello.version).number(hello.session).number(hello.first_tick);
  stream.text(hello.digest, digest_digits).rest(hello.text);
}

template <class Stream>
void pass_fields(Stream& stream, Digest& digest) {
  stream.number(digest.tick).text(digest.digest, digest_digits);
}

template <class Stream>
void pass_fields(Stream& stream, Bricks& bricks) {
  stream.number(bricks.tick).text(bricks.digest, digest_digits);
  stream.number(bricks.total).number(bricks.first).rest(bricks.bricks);
}

template <class Stream>
void pass_fields(Stream& stream, Idle& idle) {
  stream.number(idle.tick);
}

template <class Stream>
void pass_fields(Stream& stream, End& end) {
  stream.number(end.tick).text(end.digest, digest_digits).number(end.failed).rest(end.reason);
}

template <class Content>
void append(Bytes& out, int header_version, Kind kind, Content content) {
  Bytes bytes;
  ByteWriter writer(bytes);
  pass_fields(writer, content);
  openigtlink::encode_ndarray_uint8(out, envelope(kind, header_version), {bytes.data(), bytes.size()});
}

/// False if the message is of another kind, or its length is wrong.
template <class Content>
bool read(const Message& message, Kind kind, Content& content) {
  ByteView bytes;
  if (kind_of(message) == kind) openigtlink::decode_ndarray_uint8(message, bytes);
  ByteReader reader(bytes);
  pass_fields(reader, content);
  return reader.ended();
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

void encode(Bytes& out, int version, const Word& word) { append(out, version, Kind::word, word); }
void encode(Bytes& out, int version, const Hello& hello) { append(out, version, Kind::hello, hello); }
void encode(Bytes& out, int version, const Digest& digest) { append(out, version, Kind::digest, digest); }
void encode(Bytes& out, int version, const Bricks& bricks) { append(out, version, Kind::bricks, bricks); }
void encode(Bytes& out, int version, const Idle& idle) { append(out, version, Kind::idle, idle); }
void encode(Bytes& out, int version, const End& end) { append(out, version, Kind::end, end); }

bool decode(const Message& message, Word& word) {
  return read(message, Kind::word, word) && word.version == version && word.holds <= Holds::all;
}

bool decode(const Message& message, Hello& hello) {
  return read(message, Kind::hello, hello) && hello.session != 0 && is_digest(hello.digest);
}

bool decode(const Message& message, Digest& digest) { return read(message, Kind::digest, digest); }

bool decode(const Message& message, Bricks& bricks) {
  if (!read(message, Kind::bricks, bricks) || bricks.bricks.size % brick_bytes) return false;
  const std::size_t count = bricks.bricks.size / brick_bytes;
  return bricks.first <= bricks.total && count <= bricks.total - bricks.first &&
         (count > 0 || bricks.total == 0);
}

bool decode(const Message& message, Idle& idle) { return read(message, Kind::idle, idle); }

bool decode(const Message& message, End& end) { return read(message, Kind::end, end) && end.failed <= 1; }

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
  const auto count = std::uint16_t(at - values);
  openigtlink::encode_ndarray_float64(out, envelope(Kind::tick, header_version), values, count, &count, 1);
}

bool decode(const Message& message, TickMessage& tick) {
  if (kind_of(message) != Kind::tick) return false;
  std::vector<double> values;
  if (openigtlink::decode_ndarray_float64(message, values) != Drop::none) return false;
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

}  // namespace burrlab::replica_protocol
