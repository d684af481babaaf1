// Header, checksum, time and reasons; the messages themselves are in encode.cpp and decode.cpp.
#include "burrlab/network/openigtlink.hpp"

#include <chrono>

#include "big_endian.hpp"

namespace burrlab::openigtlink {
namespace {

constexpr std::uint64_t polynomial = 0x42F0E1EBA9EA3693u;  // ECMA-182, annex B

constexpr std::array<std::uint64_t, 256> make_crc_table() {
  std::array<std::uint64_t, 256> table{};
  for (std::uint64_t byte = 0; byte < 256; ++byte) {
    std::uint64_t crc = byte << 56;
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 63) ? (crc << 1) ^ polynomial : crc << 1;
    table[byte] = crc;
  }
  return table;
}

constexpr std::array<std::uint64_t, 256> crc_table = make_crc_table();

template <std::size_t N>
FixedText<N> text_until_zero(const std::uint8_t* at) {
  FixedText<N> text;
  while (text.length < N && at[text.length]) {
    text.characters[text.length] = char(at[text.length]);
    ++text.length;
  }
  return text;
}

bool printable(std::string_view text) {
  for (const char c : text)
    if (c <= ' ' || c > '~') return false;
  return !text.empty();
}

}  // namespace

const char* drop_name(Drop reason) {
  static constexpr const char* names[] = {
      "none",       "bad_version",         "bad_type",     "implausible_size", "oversized",  "unknown_type",
      "bad_crc",    "bad_extended_header", "bad_metadata", "truncated",        "wrong_type", "bad_length",
      "bad_scalar", "not_finite",          "out_of_range"};
  static_assert(sizeof names / sizeof names[0] == drop_reasons);
  return reason < Drop::count_ ? names[std::size_t(reason)] : "unknown";
}

std::uint64_t timestamp_now() {
  using namespace std::chrono;
  const auto now = duration_cast<nanoseconds>(system_clock::now().time_since_epoch()).count();
  return timestamp_of(std::uint32_t(now / 1000000000), std::uint32_t(now % 1000000000));
}

double timestamp_seconds(std::uint64_t timestamp) { return double(timestamp) / 4294967296.0; }

std::uint64_t crc64(ByteView bytes, std::uint64_t crc) {
  for (std::size_t i = 0; i < bytes.size; ++i)
    crc = crc_table[std::uint8_t(crc >> 56) ^ bytes.data[i]] ^ (crc << 8);
  return crc;
}

Drop decode_header(ByteView bytes, Header& header) {
  if (bytes.size < header_size) return Drop::truncated;
  header.version = get<std::uint16_t>(bytes.data);
  header.type = text_until_zero<type_size>(bytes.data + 2);
  header.device_name = text_until_zero<device_name_size>(bytes.data + 14);
  header.timestamp = get<std::uint64_t>(bytes.data + 34);
  header.body_size = get<std::uint64_t>(bytes.data + 42);
  header.crc = get<std::uint64_t>(bytes.data + 50);
  if (header.version != 1 && header.version != 2) return Drop::bad_version;
  if (!printable(header.type.view())) return Drop::bad_type;
  for (std::size_t i = header.type.length; i < type_size; ++i)
    if (bytes.data[2 + i]) return Drop::bad_type;
  if (header.body_size >> 32) return Drop::implausible_size;
  return Drop::none;
}

}  // namespace burrlab::openigtlink
