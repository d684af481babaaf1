// OpenIGTLink messages: header versions 1 and 2; TRANSFORM, SENSOR, STRING, NDARRAY of float64 and of uint8.
// The wire format is that of github.com/openigtlink/OpenIGTLink, Documents/Protocol (version 3), big-endian.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

namespace burrlab::openigtlink {

using Bytes = std::vector<std::uint8_t>;

/// A view of bytes.
struct ByteView {
  const std::uint8_t* data = nullptr;
  std::size_t size = 0;
};

constexpr std::size_t header_size = 58;
constexpr std::size_t type_size = 12, device_name_size = 20;  // bytes in the header
/// Newton, in the 64-bit unit field of SENSOR: no prefix, unit 0x0B with exponent 1.
constexpr std::uint64_t newton = (std::uint64_t(0x0B) << 54) | (std::uint64_t(1) << 50);
/// The longest byte string of `encode_ndarray_uint8`: two dimensions of 16 bits, minus the length.
constexpr std::uint64_t longest_byte_string = std::uint64_t(65535) * 65535 - 8;

/// Why a message was dropped. The first group is the framer's, the second the decoders'.
enum class Drop : std::uint8_t {
  none,
  bad_version,          // neither 1 nor 2: framing is lost
  bad_type,             // a type name that is not printable ASCII: framing is lost
  implausible_size,     // a body beyond 4 GiB: framing is lost
  oversized,            // a body beyond the framer's limit
  unknown_type,         // none of TRANSFORM, SENSOR, NDARRAY, GET_STRING
  bad_crc,              // the body differs from the sent one
  bad_extended_header,  // version 2: lengths that do not fit the body
  truncated,            // the connection ended within the message
  wrong_type,           // a decoder was given another type
  bad_length,           // content that disagrees with its lengths
  bad_scalar,           // an NDARRAY of another scalar type
  not_finite,           // NaN or infinity
  out_of_range,         // a position far from any bone
  count_
};
constexpr std::size_t drop_reasons = std::size_t(Drop::count_);
const char* drop_name(Drop reason);

/// A text of at most N bytes, without allocation.
template <std::size_t N>
struct FixedText {
  std::array<char, N> characters{};
  std::uint8_t length = 0;
  std::string_view view() const { return {characters.data(), length}; }
};

struct Header {
  std::uint16_t version = 1;
  FixedText<type_size> type;
  FixedText<device_name_size> device_name;
  std::uint64_t timestamp = 0;  ///< seconds since 1970 UTC, 32.32 fixed point; 0 is none
  std::uint64_t body_size = 0;  ///< bytes
  std::uint64_t crc = 0;        ///< of the body
};

/// An intact message, without its metadata. The content is a view of the framer's buffer, valid until its
/// next call.
struct Message {
  Header header;
  ByteView content;
};

/// The header of a message to be sent.
struct Envelope {
  std::string_view device_name;  ///< at most 20 bytes
  std::uint64_t timestamp = 0;   ///< 32.32 fixed point
  int version = 1;               ///< 1 or 2; 2 is sent without metadata
};

/// Rotation (row by row) and position [mm] as in the message: RAS.
struct Transform {
  std::array<float, 9> rotation{1, 0, 0, 0, 1, 0, 0, 0, 1};
  std::array<float, 3> position{};
};

/// 32.32 fixed point of seconds and nanoseconds (below 1e9) since 1970.
constexpr std::uint64_t timestamp_of(std::uint32_t seconds, std::uint32_t nanoseconds) {
  return (std::uint64_t(seconds) << 32) | ((std::uint64_t(nanoseconds) << 32) / 1000000000u);
}
/// The time of day as a timestamp.
std::uint64_t timestamp_now();

/// CRC-64 of ECMA-182 as OpenIGTLink uses it: starts at 0, most significant bit first, nothing inverted.
std::uint64_t crc64(ByteView bytes, std::uint64_t crc = 0);

// Each appends a whole message to `out`, and allocates nothing if `out` has room. The data must not lie in
// `out`. Throws InvalidArgument if the message cannot hold the data; `out` is then unchanged.
void encode_transform(Bytes& out, const Envelope& envelope, const Transform& transform);
void encode_sensor(Bytes& out, const Envelope& envelope, const double* values, std::size_t count);  ///< [N]
/// US-ASCII, at most 65535 bytes.
void encode_string(Bytes& out, const Envelope& envelope, std::string_view text);
/// Values in C order; their number is the product of `shape` (1 to 255 dimensions).
void encode_ndarray_float64(Bytes& out, const Envelope& envelope, const double* values, std::size_t count,
                            const std::uint16_t* shape, std::size_t dimensions);
/// A byte string of at most `longest_byte_string`: its length in 8 bytes (ours), the bytes, and zeros up to a
/// whole number of rows. One dimension up to 65535 bytes, then two.
void encode_ndarray_uint8(Bytes& out, const Envelope& envelope, ByteView bytes);

// Decoders. They return Drop::none, or the reason; the result is then meaningless.
Drop decode_header(ByteView bytes, Header& header);
/// Finds the content in the body of a version 1 or 2 message; checks every length, not the CRC.
Drop decode_body(const Header& header, ByteView body, Message& message);
Drop decode_transform(const Message& message, Transform& transform);
Drop decode_ndarray_float64(const Message& message, std::vector<double>& values);
/// The byte string of `encode_ndarray_uint8`, a view into the message.
Drop decode_ndarray_uint8(const Message& message, ByteView& bytes);

}  // namespace burrlab::openigtlink
