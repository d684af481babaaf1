// Mutated OpenIGTLink streams, without libFuzzer: valid messages, broken as by bad wires and by attackers.
// fuzz_openigtlink [INPUTS [SECONDS [SEED]]] ends after either; defaults 10^5 inputs and 600 s.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>

#include "fuzz_run.hpp"
#include "network/replica_protocol.hpp"
#include "openigtlink_target.hpp"

namespace {

using namespace burrlab::openigtlink;

class Mutator {
 public:
  explicit Mutator(std::uint64_t seed) : random_(seed) {}

  std::uint64_t word() { return random_(); }

  /// One to six messages; about half of them, and at times the whole stream, are changed.
  Bytes stream() {
    Bytes bytes;
    for (std::uint64_t left = 1 + below(6); left > 0; --left) {
      Bytes message = valid();
      if (below(2)) change(message);
      bytes.insert(bytes.end(), message.begin(), message.end());
    }
    if (below(8) == 0) cut(bytes);
    if (below(8) == 0) flip(bytes, 0, 1 + below(8));
    if (below(64) == 0) noise(bytes);
    return bytes;
  }

 private:
  std::uint64_t below(std::uint64_t n) { return random_() % n; }

  double number() {
    static constexpr double special[] = {0.0, -0.0, 1.0, 1e300, 5e-324, 9007199254740991.0};
    return below(2) ? special[below(6)] : double(random_()) * 1e-15 - 9000.0;
  }

  Bytes valid() {
    const Envelope envelope{device_names[below(4)], random_(), int(1 + below(2))};
    Bytes bytes;
    switch (below(5)) {
      case 4:
        encode_protocol(bytes, envelope.version);
        break;
      case 0:
        encode_a_transform(bytes, envelope);
        break;
      case 1:
        encode_some_values(bytes, envelope, true);
        break;
      case 2:
        encode_some_values(bytes, envelope, false);
        break;
      default: {
        const Bytes text(below(8) ? below(300) : 4000 + below(300), std::uint8_t(random_()));
        encode_ndarray_uint8(bytes, envelope, {text.data(), text.size()});
      }
    }
    if (envelope.version == 2 && below(2)) add_metadata(bytes);
    return bytes;
  }

  /// Keys and values in the place of none, with their lengths in the extended header.
  void add_metadata(Bytes& bytes) {
    const std::uint64_t size = below(800);
    bytes[header_size + 6] = std::uint8_t(size >> 8);
    bytes[header_size + 7] = std::uint8_t(size);
    bytes.resize(bytes.size() + size, 'v');
    sign(bytes);
  }

  /// Messages between leaders and replicas.
  void encode_protocol(Bytes& bytes, int version) {
    using namespace burrlab::replica_protocol;
    const std::string digest(digest_digits, "0123456789abcdef"[below(16)]);
    const std::string text(below(30), char(random_()));
    switch (below(7)) {
      case 0:
        return encode(bytes, version, Word{Holds(below(4)), random_(), random_() >> below(64), digest});
      case 1:
        return encode(bytes, version, Hello{std::uint32_t(below(3)), random_(), below(1000), digest, text});
      case 2:
        return encode(bytes, version, Digest{random_() >> below(64), digest});
      case 3:
        return encode(bytes, version, Idle{random_() >> below(64)});
      case 4:
        return encode(bytes, version, End{random_() >> below(64), digest, std::uint32_t(below(3)), text});
      case 5: {
        const Bytes some(below(4) * brick_bytes, std::uint8_t(random_()));
        const auto first = std::uint32_t(below(3)), total = std::uint32_t(below(8));
        return encode(bytes, version, Bricks{below(1000), digest, total, first, {some.data(), some.size()}});
      }
      default: {
        TickMessage tick;
        tick.record.index = random_() >> (11 + below(53));
        tick.record.k = std::uint32_t(below(10));
        tick.record.burrs = std::uint32_t(below(4));
        for (burrlab::BurrRecord& burr : tick.record.burr) {
          for (double& c : burr.center) c = number();
          for (double& f : burr.force) f = number();
          burr.penetration = number();
          burr.removed = std::int64_t(below(1000));
        }
        return encode(bytes, version, tick);
      }
    }
  }

  void encode_a_transform(Bytes& bytes, const Envelope& envelope) {
    Transform transform;
    for (float& value : transform.position) value = float(int(below(20000)) - 10000) / 100;
    encode_transform(bytes, envelope, transform);
  }

  void encode_some_values(Bytes& bytes, const Envelope& envelope, bool sensor) {
    std::vector<double> values(below(30));
    for (double& value : values) value = number();
    if (sensor) return encode_sensor(bytes, envelope, values.data(), values.size());
    const std::uint16_t shape[] = {1, std::uint16_t(values.size()), 1};
    encode_ndarray_float64(bytes, envelope, values.data(), values.size(), shape + below(2), 2);
  }

  void change(Bytes& message) {
    switch (below(8)) {
      case 0:
        flip(message, 0, 1 + below(4));
        break;
      case 1:
        flip(message, header_size, 1 + below(4));
        break;  // the checksum shows it
      case 2:
        cut(message);
        break;
      case 3:
        set_body_size(message);
        break;
      case 4:
        flip(message, 0, 1);
        break;
      default:  // a right checksum over wrong content
        if (below(4) == 0) grow(message);
        for (std::uint64_t left = 1 + below(3); left > 0; --left) lie(message);
        sign(message);
    }
  }

  void flip(Bytes& bytes, std::size_t from, std::uint64_t times) {
    if (bytes.size() <= from) return;
    for (; times > 0; --times) bytes[from + below(bytes.size() - from)] ^= std::uint8_t(1u << below(8));
  }

  /// Removes or inserts bytes, or loses the end.
  void cut(Bytes& bytes) {
    if (bytes.empty()) return;
    const std::size_t at = below(bytes.size());
    const std::size_t some = below(std::min<std::size_t>(bytes.size() - at, 200) + 1);
    const auto begin = bytes.begin() + std::ptrdiff_t(at);
    if (below(3) == 0)
      bytes.erase(begin, bytes.end());
    else if (below(2))
      bytes.erase(begin, begin + std::ptrdiff_t(some));
    else
      bytes.insert(begin, some, std::uint8_t(random_()));
  }

  void noise(Bytes& bytes) {
    for (std::uint8_t& byte : bytes) byte = std::uint8_t(random_());
  }

  /// Writes an edge case or any number over 1, 2, 4 or 8 bytes, mostly at the front, where lengths are.
  void lie(Bytes& message) {
    static constexpr std::uint64_t edges[] = {0,   1,   2,   11,   12,    13,       48,
                                              127, 255, 256, 4096, 65535, 1u << 31, ~0ull};
    const std::size_t body = message.size() - header_size;
    if (body == 0) return;
    const std::size_t at = header_size + below(below(4) ? std::min<std::size_t>(body, 32) : body);
    const std::size_t width = std::min(std::size_t(1) << below(4), message.size() - at);
    std::uint64_t value = below(4) ? edges[below(14)] : random_();
    for (std::size_t i = width; i-- > 0; value >>= 8) message[at + i] = std::uint8_t(value);
  }

  void grow(Bytes& message) {
    message.resize(std::max<std::size_t>(header_size, message.size() + below(40) - 20),
                   std::uint8_t(random_()));
  }

  void set_body_size(Bytes& message) {
    static constexpr std::uint64_t sizes[] = {0,        1,           4095,       4096, 4097,
                                              1u << 20, 0xFFFFFFFFu, 1ull << 32, ~0ull};
    put_word(message, 42, below(3) ? sizes[below(9)] : message.size() - header_size + below(9) - 4);
  }

  void sign(Bytes& message) {
    const ByteView body{message.data() + header_size, message.size() - header_size};
    put_word(message, 42, body.size);
    put_word(message, 50, crc64(body));
  }

  static void put_word(Bytes& message, std::size_t at, std::uint64_t value) {
    for (int i = 0; i < 8; ++i) message[at + i] = std::uint8_t(value >> (56 - 8 * i));
  }

  static constexpr const char* device_names[] = {"", "burr", "burr_off", "a device of 20 bytes"};
  std::mt19937_64 random_;
};

}  // namespace

int main(int count, char** argument) {
  FuzzRun run(count, argument);
  Mutator mutator(run.seed);
  Counters total;
  for (; run.more(); ++run.done) {
    const Bytes stream = mutator.stream();
    const Counters counters = fuzz::run(stream, mutator.word());
    total.messages += counters.messages;
    for (std::size_t i = 0; i < drop_reasons; ++i) total.dropped[i] += counters.dropped[i];
  }
  run.say(total.messages);
  bool all_met = true;
  for (std::size_t i = 0; i < drop_reasons; ++i) {
    const bool of_framer = i >= std::size_t(Drop::bad_version) && i <= std::size_t(Drop::truncated);
    if (of_framer) std::printf("%10llu %s\n", (unsigned long long)total.dropped[i], drop_name(Drop(i)));
    if (of_framer && total.dropped[i] == 0) all_met = false;
  }
  if (all_met || run.done < 10000) return 0;
  std::printf("a reason was never met: the mutations are too tame\n");
  return 1;
}
