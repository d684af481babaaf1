// Broken VRPN streams and UDP packets, as fuzz_openigtlink does. fuzz_vrpn [INPUTS [SECONDS [SEED]]].
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>

#include "fuzz_run.hpp"
#include "network/vrpn_log.hpp"

namespace {

using namespace burrlab::vrpn;
using burrlab::openigtlink::Counters;

#define REQUIRE(condition) \
  if (!(condition)) std::fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition), std::abort()

constexpr std::size_t largest = 4096;
const std::vector<std::string> senders{"Tracker0", "burrlab_burr_1"};

class Mutator {
 public:
  explicit Mutator(std::uint64_t seed) : random_(seed) {}
  std::uint64_t below(std::uint64_t n) { return random_() % n; }

  /// A cookie, descriptions and up to eight messages.
  Bytes valid(bool greeting) {
    Bytes bytes;
    if (greeting) {
      encode_cookie(bytes);
      encode_descriptions(bytes, senders);
    }
    for (std::uint64_t left = below(8); left > 0; --left) append(bytes);
    return bytes;
  }

  /// Mostly something in the bytes is changed.
  Bytes changed(Bytes bytes, bool greeting) {
    if (greeting && below(16) == 0) flip(bytes, 0);
    const std::size_t from = greeting && below(8) ? header_size : 0;
    for (std::uint64_t left = below(4); left > 0; --left) below(2) ? flip(bytes, from) : lie(bytes, from);
    if (below(8) == 0) cut(bytes);
    return bytes;
  }

 private:
  double number() {
    static constexpr double special[] = {0.0, -0.0, 1.0, 1e300, 5e-324, NAN, INFINITY};
    return below(4) ? double(random_()) * 1e-18 - 9.0 : special[below(7)];
  }

  void append(Bytes& bytes) {
    const auto sender = std::int32_t(below(3));
    const burrlab::Vec3 vector(number(), number(), number());
    const burrlab::Quaternion q{number(), number(), number(), number()};
    const std::size_t at = bytes.size();
    switch (below(6)) {
      case 0:
        return encode_pong(bytes, sender, random_());
      case 1:
        return encode_force(bytes, sender, random_(), vector);
      case 2:
        return encode_velocity(bytes, sender, random_(), vector, q, number());
      case 3:
        return encode_udp(bytes, std::string(below(40), 'h'), int(below(70000)));
      case 4:  // a button's or the buttons'
        encode_force(bytes, sender, random_(), vector);
        bytes[at + 19] = std::uint8_t(2 + below(2));
        bytes[at + 3] = std::uint8_t(header_size + 4 * below(6));
        bytes[at + header_size + 3] = std::uint8_t(below(6));
        for (std::size_t i = 0; i < 3; ++i) bytes[at + header_size + i] = 0;
        return bytes.resize(at + header_size + (bytes[at + 3] - header_size + 7) / 8 * 8);
      default:
        return encode_pose(bytes, sender, random_(), vector, q);
    }
  }

  void flip(Bytes& bytes, std::size_t from) {
    if (bytes.size() > from) bytes[from + below(bytes.size() - from)] ^= std::uint8_t(1u << below(8));
  }

  /// An edge case over 4 bytes, where a length or a number may be.
  void lie(Bytes& bytes, std::size_t from) {
    static constexpr std::uint32_t edges[] = {0,  1,   2,   23,   24,   25,   31,         32,
                                              99, 100, 101, 4120, 4121, 2000, 0x7FFFFFFF, ~0u};
    if (bytes.size() < from + 8) return;
    const std::size_t at = from + below((bytes.size() - from) / 4) * 4;
    const std::uint32_t value = below(4) ? edges[below(16)] : std::uint32_t(random_());
    for (std::size_t i = 0; i < 4; ++i) bytes[at + i] = std::uint8_t(value >> (24 - 8 * i));
  }

  void cut(Bytes& bytes) {
    if (bytes.empty()) return;
    const auto at = bytes.begin() + std::ptrdiff_t(below(bytes.size()));
    bytes.erase(at, below(2) ? bytes.end() : std::min(bytes.end(), at + std::ptrdiff_t(below(60))));
  }

  std::mt19937_64 random_;
};

/// The messages of a valid stream as a log file holds them.
Bytes log_of(const Bytes& stream) {
  Bytes log(stream.begin(), stream.begin() + header_size);
  for (auto at = stream.begin() + header_size; at < stream.end();) {
    const std::size_t size = std::size_t(at[2]) << 8 | at[3], payload = size - header_size;
    log.insert(log.end(), at + 16, at + 20);  // type
    log.insert(log.end(), at + 12, at + 16);  // sender
    log.insert(log.end(), at + 4, at + 12);   // time
    log.insert(log.end(), {0, 0, std::uint8_t(payload >> 8), std::uint8_t(payload), 0, 0, 0, 0});
    log.insert(log.end(), at + header_size, at + std::ptrdiff_t(size));
    at += std::ptrdiff_t((size + 7) / 8 * 8);
  }
  return log;
}

/// Whether a log is read, not refused; its columns have a row for each message.
bool reads(const Bytes& bytes) {
  try {
    for (const LoggedMessages& messages : read_log({bytes.data(), bytes.size()}).messages) {
      REQUIRE(messages.numbers.size() == messages.times.size());
      REQUIRE(messages.times.empty() || messages.values.size() % messages.times.size() == 0);
    }
    return true;
  } catch (const std::invalid_argument&) {
    return false;
  }
}

/// What a message holds must be usable, and encoded again it must decode to the same.
void check(const Message& message) {
  REQUIRE(message.sender < senders.size() && message.text.size() < 100);
  for (const double value : message.values) REQUIRE(std::isfinite(value));
  if (message.kind == Kind::udp) REQUIRE(message.number > 0 && message.number < 65536);
  if (message.kind != Kind::pose || message.number != 0) return;
  const auto& v = message.values;
  Bytes bytes;
  encode_cookie(bytes);
  encode_descriptions(bytes, senders);
  encode_pose(bytes, std::int32_t(message.sender), message.timestamp, {v[0], v[1], v[2]},
              {v[6], v[3], v[4], v[5]});
  Reader reader(senders, largest);
  bool same = false;
  REQUIRE(reader.feed({bytes.data(), bytes.size()}, [&](const Message& again) {
    same = again.kind == Kind::pose && again.values == v && again.timestamp == message.timestamp;
  }));
  REQUIRE(same);
}

}  // namespace

int main(int count, char** argument) {
  FuzzRun run(count, argument);
  Mutator mutator(run.seed);
  Counters total;
  std::uint64_t logs_read = 0;
  Reader whole(senders, largest), pieces(senders, largest);
  const auto add = [&](Reader& reader) {
    total.messages += reader.counters().messages;
    for (std::size_t i = 0; i < burrlab::openigtlink::drop_reasons; ++i)
      total.dropped[i] += reader.counters().dropped[i];
  };
  for (; run.more(); ++run.done) {
    const Bytes stream = mutator.valid(true), log = log_of(stream);
    logs_read += reads(log) + reads(mutator.changed(log, true));
    const Bytes bytes = mutator.changed(stream, true), packet = mutator.changed(mutator.valid(false), false);
    const bool checked = run.done % 16 == 0;
    std::size_t heard = 0, heard_in_pieces = 0;
    const auto once = [&](const Message& message) {
      ++heard;
      if (checked) check(message);
    };
    const bool good = whole.feed({bytes.data(), bytes.size()}, once);
    bool good_in_pieces = true;
    for (std::size_t at = 0; at < bytes.size();) {
      const std::size_t size = std::min<std::size_t>(1 + mutator.below(300), bytes.size() - at);
      const Bytes piece(bytes.begin() + std::ptrdiff_t(at), bytes.begin() + std::ptrdiff_t(at + size));
      good_in_pieces = pieces.feed({piece.data(), size}, [&](const Message&) { ++heard_in_pieces; });
      at += size;
    }
    REQUIRE(heard == heard_in_pieces && (good == good_in_pieces || bytes.empty()));
    whole.feed_datagram({packet.data(), packet.size()}, once);
    REQUIRE(whole.memory() <= header_size + largest);
    whole.restart();
    pieces.restart();
  }
  add(whole);
  run.say(total.messages);
  std::printf("%10llu of %llu logs read\n", (unsigned long long)logs_read, 2 * (unsigned long long)run.done);
  REQUIRE(run.done < 10000 || (logs_read > run.done / 4 && logs_read < 2 * run.done));
  for (const Drop reason : {Drop::bad_version, Drop::implausible_size, Drop::truncated, Drop::bad_length,
                            Drop::not_finite, Drop::out_of_range}) {
    std::printf("%10llu %s\n", (unsigned long long)total[reason], drop_name(reason));
    if (total[reason] == 0 && run.done >= 10000) return std::printf("a reason was never met\n"), 1;
  }
  return 0;
}
