#include "openigtlink_target.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>

#include "network/replica_protocol.hpp"

namespace fuzz {
namespace {

using namespace burrlab::openigtlink;

#define REQUIRE(condition) \
  if (!(condition)) std::fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition), std::abort()

bool within(ByteView part, ByteView whole) {
  return part.size == 0 || (part.data >= whole.data && part.data + part.size <= whole.data + whole.size);
}

/// An accepted message, encoded again, decodes to the same bytes.
Message again(const Bytes& bytes) {
  Header header;
  Message message;
  REQUIRE(decode_header({bytes.data(), bytes.size()}, header) == Drop::none);
  const ByteView body{bytes.data() + header_size, bytes.size() - header_size};
  REQUIRE(crc64(body) == header.crc && decode_body(header, body, message) == Drop::none);
  return message;
}

bool equal(ByteView a, ByteView b) {
  return a.size == b.size && (a.size == 0 || std::memcmp(a.data, b.data, a.size) == 0);
}

void check_transform(const Message& message, const Envelope& envelope) {
  Transform transform;
  if (decode_transform(message, transform) != Drop::none) return;
  Bytes bytes;
  encode_transform(bytes, envelope, transform);
  REQUIRE(equal(again(bytes).content, message.content));
}

void check_arrays(const Message& message, const Envelope& envelope) {
  std::vector<double> values;
  Bytes bytes;
  if (decode_ndarray_float64(message, values) == Drop::none) {
    REQUIRE(8 * values.size() <= largest_body);
    std::uint16_t shape[255];
    const std::size_t dimensions = message.content.data[1];
    for (std::size_t i = 0; i < dimensions; ++i)
      shape[i] = std::uint16_t(message.content.data[2 + 2 * i] << 8 | message.content.data[3 + 2 * i]);
    encode_ndarray_float64(bytes, envelope, values.data(), values.size(), shape, dimensions);
    REQUIRE(equal(again(bytes).content, message.content));
  }
  ByteView text, second;
  if (decode_ndarray_uint8(message, text) == Drop::none) {
    REQUIRE(within(text, message.content));
    bytes.clear();
    encode_ndarray_uint8(bytes, envelope, text);
    REQUIRE(decode_ndarray_uint8(again(bytes), second) == Drop::none && equal(text, second));
  }
}

/// An accepted message of a leader or a replica is valid, and the same when encoded again.
template <class Content>
void check_protocol(const Message& message, Content content) {
  using namespace burrlab::replica_protocol;
  if (!decode(message, content)) return;
  if constexpr (std::is_same_v<Content, TickMessage>) {
    REQUIRE(content.record.k >= 1 && content.record.k <= burrlab::most_periods);
    REQUIRE(content.record.burrs >= 1 && content.record.burrs <= burrlab::most_burrs);
    for (std::uint32_t i = 0; i < content.record.burrs; ++i)
      for (const double c : content.record.burr[i].center) REQUIRE(std::isfinite(c));
  }
  if constexpr (std::is_same_v<Content, Bricks>) {
    REQUIRE(within(content.bricks, message.content) && content.bricks.size % brick_bytes == 0);
    REQUIRE(content.first + content.bricks.size / brick_bytes <= content.total);
  }
  Bytes first, second;
  encode(first, message.header.version, content);
  const Message said = again(first);
  REQUIRE(decode(said, content));
  encode(second, message.header.version, content);
  REQUIRE(equal(again(second).content, said.content));
}

void check_protocols(const Message& message) {
  using namespace burrlab::replica_protocol;
  check_protocol(message, Word{});
  check_protocol(message, Hello{});
  check_protocol(message, TickMessage{});
  check_protocol(message, Digest{});
  check_protocol(message, Bricks{});
  check_protocol(message, Idle{});
  check_protocol(message, End{});
}

void check(const Message& message) {
  const Header& header = message.header;
  REQUIRE(header.version == 1 || header.version == 2);
  REQUIRE(header.body_size <= largest_body && message.content.size <= header.body_size);
  const Envelope envelope{header.device_name.view(), header.timestamp, header.version};
  check_transform(message, envelope);
  check_arrays(message, envelope);
  check_protocols(message);
}

std::uint64_t next(std::uint64_t& state) {  // splitmix64
  std::uint64_t z = (state += 0x9E3779B97F4A7C15u);
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
  return z ^ (z >> 31);
}

void check_counters(const MessageFramer& framer, std::uint64_t delivered, std::size_t stream_size) {
  const Counters& counters = framer.counters();
  REQUIRE(counters.messages == delivered);
  REQUIRE((counters.messages + counters.all_dropped()) * header_size <= stream_size);
  REQUIRE(framer.memory() <= header_size + largest_body);
  const std::uint64_t lost =
      counters[Drop::bad_version] + counters[Drop::bad_type] + counters[Drop::implausible_size];
  REQUIRE(lost == (framer.broken() ? 1u : 0u));
  for (const Drop of_decoder : {Drop::none, Drop::wrong_type, Drop::bad_scalar, Drop::not_finite})
    REQUIRE(counters[of_decoder] == 0);
}

}  // namespace

Counters run(const Bytes& stream, std::uint64_t splits) {
  MessageFramer framer(largest_body);
  std::uint64_t delivered = 0;
  const MessageFramer::Receive receive = [&](const Message& message) {
    ++delivered;
    check(message);
  };
  for (std::size_t at = 0; at < stream.size();) {
    const std::uint64_t word = next(splits);
    const std::size_t longest = word % 4 == 0 ? 8 : word % 4 == 1 ? 80 : 4000;
    const std::size_t size = std::min<std::size_t>(1 + (word >> 8) % longest, stream.size() - at);
    const std::unique_ptr<std::uint8_t[]> piece(new std::uint8_t[size]);  // so that a byte beyond it is found
    std::memcpy(piece.get(), stream.data() + at, size);
    REQUIRE(framer.feed({piece.get(), size}, receive) == !framer.broken());
    at += size;
  }
  check_counters(framer, delivered, stream.size());

  // The same bytes at once: splits make no difference.
  MessageFramer whole(largest_body);
  whole.feed({stream.data(), stream.size()}, [](const Message&) {});
  REQUIRE(whole.counters().dropped == framer.counters().dropped && whole.counters().messages == delivered);

  framer.restart();
  const Counters counters = framer.counters();
  Bytes valid;
  Transform transform;
  transform.position = {1, 2, 3};
  encode_transform(valid, {"after"}, transform);
  REQUIRE(framer.feed({valid.data(), valid.size()}, receive) &&
          framer.counters().messages == counters.messages + 1);
  return counters;
}

}  // namespace fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  std::uint64_t splits = 0;
  std::memcpy(&splits, bytes, std::min<std::size_t>(size, 2));
  fuzz::run({bytes, bytes + size}, splits);
  return 0;
}
