// Encoders make room, write the body in place, then its checksum. Decoders check every length before its use.
#include "network/openigtlink.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "require.hpp"
#include "wire.hpp"

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

template <class Float>
void require_all_finite(const char* name, const Float* values, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i)  // require_finite would make a string of the name each time
    if (!std::isfinite(values[i])) refuse(name, "finite", double(values[i]));
}

/// Writes all but the content, which `write(at)` writes, then the checksum.
template <class Write>
void append(Bytes& out, const Envelope& envelope, std::string_view type, std::size_t content_size,
            Write&& write) {
  if (envelope.version != 1 && envelope.version != 2) refuse("version", "1 or 2", envelope.version);
  if (envelope.device_name.size() > device_name_size)
    refuse("length of device_name", "at most 20", double(envelope.device_name.size()));
  const std::size_t extended = envelope.version == 2 ? extended_header_size : 0;
  const std::size_t metadata = envelope.version == 2 ? metadata_count_size : 0;  // of no entries
  const std::size_t body_size = extended + content_size + metadata;
  const std::size_t begin = out.size();
  out.resize(begin + header_size + body_size);  // new bytes are zero: padding, and lengths of no metadata

  std::uint8_t* const head = out.data() + begin;
  std::uint8_t* const body = head + header_size;
  if (envelope.version == 2) {
    put(body, std::uint16_t(extended_header_size));
    put(body + 2, std::uint16_t(metadata));
  }
  write(body + extended);

  put(head, std::uint16_t(envelope.version));
  std::copy(type.begin(), type.end(), head + 2);
  std::copy(envelope.device_name.begin(), envelope.device_name.end(), head + 14);
  put(head + 34, envelope.timestamp);
  put(head + 42, std::uint64_t(body_size));
  put(head + 50, crc64({body, body_size}));
}

/// Returns where the data begin.
std::uint8_t* put_array_head(std::uint8_t* at, std::uint8_t scalar, const std::uint16_t* shape,
                             std::size_t dimensions) {
  *at++ = scalar;
  *at++ = std::uint8_t(dimensions);
  for (std::size_t i = 0; i < dimensions; ++i, at += 2) put(at, shape[i]);
  return at;
}

bool is(const Message& message, std::string_view type) { return message.header.type.view() == type; }

/// Finds the elements of an array, each of `size` bytes.
Drop decode_array(const Message& message, std::uint8_t scalar, std::size_t size, ByteView& elements) {
  if (!is(message, ndarray_type)) return Drop::wrong_type;
  const ByteView content = message.content;
  if (content.size < 2) return Drop::bad_length;
  if (content.data[0] != scalar) return Drop::bad_scalar;
  const std::size_t dimensions = content.data[1], head_size = 2 + 2 * dimensions;
  if (dimensions == 0 || content.size < head_size) return Drop::bad_length;
  std::uint16_t shape[255];
  for (std::size_t i = 0; i < dimensions; ++i) shape[i] = get<std::uint16_t>(content.data + 2 + 2 * i);
  elements = {content.data + head_size, content.size - head_size};
  const bool whole = elements.size % size == 0 && holds(shape, dimensions, elements.size / size);
  return whole ? Drop::none : Drop::bad_length;
}

}  // namespace

const char* drop_name(Drop reason) {
  static constexpr const char* names[] = {"none",       "bad_version",  "bad_type",   "implausible_size",
                                          "oversized",  "unknown_type", "bad_crc",    "bad_extended_header",
                                          "truncated",  "wrong_type",   "bad_length", "bad_scalar",
                                          "not_finite", "out_of_range"};
  static_assert(sizeof names / sizeof names[0] == drop_reasons);
  return reason < Drop::count_ ? names[std::size_t(reason)] : "unknown";
}

std::uint64_t timestamp_now() {
  using namespace std::chrono;
  const auto now = duration_cast<nanoseconds>(system_clock::now().time_since_epoch()).count();
  return timestamp_of(std::uint32_t(now / 1000000000), std::uint32_t(now % 1000000000));
}

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

void encode_transform(Bytes& out, const Envelope& envelope, const Transform& transform) {
  require_all_finite("every number of rotation", transform.rotation.data(), 9);
  require_all_finite("every number of position", transform.position.data(), 3);
  append(out, envelope, transform_type, transform_size, [&](std::uint8_t* at) {
    for (int column = 0; column < 3; ++column)  // the message holds columns
      for (int row = 0; row < 3; ++row, at += 4) put(at, transform.rotation[3 * row + column]);
    for (int row = 0; row < 3; ++row, at += 4) put(at, transform.position[row]);
  });
}

void encode_sensor(Bytes& out, const Envelope& envelope, const double* values, std::size_t count) {
  if (count > 255) refuse("number of values", "at most 255", double(count));
  require_all_finite("every value", values, count);
  append(out, envelope, sensor_type, sensor_head_size + 8 * count, [&](std::uint8_t* at) {
    at[0] = std::uint8_t(count);
    at[1] = 0;
    put(at + 2, newton);
    at += sensor_head_size;
    for (std::size_t i = 0; i < count; ++i, at += 8) put(at, values[i]);
  });
}

void encode_string(Bytes& out, const Envelope& envelope, std::string_view text) {
  if (text.size() > 65535) refuse("length of text", "at most 65535 bytes", double(text.size()));
  append(out, envelope, string_type, 4 + text.size(), [&](std::uint8_t* at) {
    put(at, us_ascii);
    put(at + 2, std::uint16_t(text.size()));
    std::copy(text.begin(), text.end(), at + 4);
  });
}

void encode_ndarray_float64(Bytes& out, const Envelope& envelope, const double* values, std::size_t count,
                            const std::uint16_t* shape, std::size_t dimensions) {
  if (dimensions < 1 || dimensions > 255) refuse("number of dimensions", "1 to 255", double(dimensions));
  if (!holds(shape, dimensions, count)) refuse("product of shape", "the number of values", double(count));
  append(out, envelope, ndarray_type, 2 + 2 * dimensions + 8 * count, [&](std::uint8_t* at) {
    at = put_array_head(at, scalar_float64, shape, dimensions);
    for (std::size_t i = 0; i < count; ++i, at += 8) put(at, values[i]);
  });
}

void encode_ndarray_uint8(Bytes& out, const Envelope& envelope, ByteView bytes) {
  if (bytes.size > longest_byte_string) refuse("length of bytes", "at most 4294836217", double(bytes.size));
  const std::size_t used = byte_string_prefix + bytes.size;
  const std::size_t rows = (used + 65534) / 65535;
  const std::size_t columns = (used + rows - 1) / rows;
  const std::size_t dimensions = rows == 1 ? 1 : 2;
  const std::uint16_t shape[] = {std::uint16_t(rows), std::uint16_t(columns)};
  append(out, envelope, ndarray_type, 2 + 2 * dimensions + rows * columns, [&](std::uint8_t* at) {
    at = put_array_head(at, scalar_uint8, shape + 2 - dimensions, dimensions);
    put(at, std::uint64_t(bytes.size));
    std::copy(bytes.data, bytes.data + bytes.size, at + byte_string_prefix);
  });
}

Drop decode_body(const Header& header, ByteView body, Message& message) {
  message = Message{header, body};
  if (body.size != header.body_size) return Drop::bad_length;
  if (header.version == 1) return Drop::none;
  if (body.size < extended_header_size) return Drop::bad_extended_header;
  const std::size_t extended = get<std::uint16_t>(body.data);
  const std::size_t keys = get<std::uint16_t>(body.data + 2), values = get<std::uint32_t>(body.data + 4);
  if (extended < extended_header_size || extended > body.size) return Drop::bad_extended_header;
  if (keys > body.size - extended || values > body.size - extended - keys) return Drop::bad_extended_header;
  message.content = {body.data + extended, body.size - extended - keys - values};
  return Drop::none;
}

Drop decode_transform(const Message& message, Transform& transform) {
  if (!is(message, transform_type)) return Drop::wrong_type;
  if (message.content.size != transform_size) return Drop::bad_length;
  const std::uint8_t* at = message.content.data;
  bool finite = true;
  for (int column = 0; column < 4; ++column) {
    for (int row = 0; row < 3; ++row, at += 4) {
      const float value = get<float>(at);
      finite = finite && std::isfinite(value);
      (column < 3 ? transform.rotation[3 * row + column] : transform.position[row]) = value;
    }
  }
  return finite ? Drop::none : Drop::not_finite;
}

Drop decode_ndarray_float64(const Message& message, std::vector<double>& values) {
  ByteView elements;
  const Drop reason = decode_array(message, scalar_float64, 8, elements);
  if (reason != Drop::none) return reason;
  values.resize(elements.size / 8);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = get<double>(elements.data + 8 * i);
  return Drop::none;
}

Drop decode_ndarray_uint8(const Message& message, ByteView& bytes) {
  ByteView elements;
  const Drop reason = decode_array(message, scalar_uint8, 1, elements);
  if (reason != Drop::none) return reason;
  if (elements.size < byte_string_prefix) return Drop::bad_length;
  const std::uint64_t length = get<std::uint64_t>(elements.data);
  if (length > elements.size - byte_string_prefix) return Drop::bad_length;
  bytes = {elements.data + byte_string_prefix, std::size_t(length)};
  return Drop::none;
}

}  // namespace burrlab::openigtlink
