// Encoders make room, write the body in place, then its checksum. Decoders check every length before its use.
#include "burrlab/network/openigtlink.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "burrlab/check.hpp"
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

void require_text(const char* name, std::string_view text, std::size_t longest) {
  if (text.size() > longest)
    refuse(std::string("length of ") + name, "at most " + std::to_string(longest), double(text.size()));
  if (text.find('\0') != std::string_view::npos) {
    const std::string begin(text.substr(0, text.find('\0')));
    throw std::invalid_argument(std::string(name) + " must hold no zero byte, got one after '" + begin + "'");
  }
}

template <class Float>
void require_all_finite(const char* name, const Float* values, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i)  // require_finite would make a string of the name each time
    if (!std::isfinite(values[i])) refuse(name, "finite", double(values[i]));
}

struct MetadataSizes {
  std::size_t header = 0, body = 0;
};

MetadataSizes metadata_sizes(const Envelope& envelope) {
  if (envelope.version == 1) return {};
  MetadataSizes sizes{metadata_count_size, 0};
  if (!envelope.metadata) return sizes;
  for (const MetadataEntry& entry : *envelope.metadata) {
    if (entry.key.size() > 65535)
      refuse("length of a metadata key", "at most 65535", double(entry.key.size()));
    sizes.header += metadata_entry_size;
    sizes.body += entry.key.size() + entry.value.size();
  }
  if (sizes.header > 65535)
    refuse("number of metadata entries", "at most 8191", double(envelope.metadata->size()));
  if (sizes.body >> 32) refuse("length of the metadata", "below 4 GiB", double(sizes.body));
  return sizes;
}

void put_metadata(std::uint8_t* at, const std::vector<MetadataEntry>& entries) {
  put(at, std::uint16_t(entries.size()));
  std::uint8_t* lengths = at + metadata_count_size;
  std::uint8_t* text = lengths + metadata_entry_size * entries.size();
  for (const MetadataEntry& entry : entries) {
    put(lengths, std::uint16_t(entry.key.size()));
    put(lengths + 2, entry.encoding);
    put(lengths + 4, std::uint32_t(entry.value.size()));
    lengths += metadata_entry_size;
    text = std::copy(entry.key.begin(), entry.key.end(), text);
    text = std::copy(entry.value.begin(), entry.value.end(), text);
  }
}

/// Writes all but the content, which `write(at)` writes, then the checksum.
template <class Write>
void append(Bytes& out, const Envelope& envelope, std::string_view type, std::size_t content_size,
            Write&& write) {
  if (envelope.version != 1 && envelope.version != 2) refuse("version", "1 or 2", envelope.version);
  require_text("device_name", envelope.device_name, device_name_size);
  if (envelope.version == 1 && envelope.metadata && !envelope.metadata->empty())
    refuse("version", "2 for a message with metadata", envelope.version);
  const std::size_t extended = envelope.version == 2 ? extended_header_size : 0;
  const MetadataSizes metadata = metadata_sizes(envelope);
  const std::size_t body_size = extended + content_size + metadata.header + metadata.body;
  const std::size_t begin = out.size();
  out.resize(begin + header_size + body_size);  // new bytes are zero: the padding of texts

  std::uint8_t* const head = out.data() + begin;
  std::uint8_t* const body = head + header_size;
  if (envelope.version == 2) {
    put(body, std::uint16_t(extended_header_size));
    put(body + 2, std::uint16_t(metadata.header));
    put(body + 4, std::uint32_t(metadata.body));
    put(body + 8, envelope.message_id);
    if (envelope.metadata) put_metadata(body + extended + content_size, *envelope.metadata);
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

/// Calls `entry(key, encoding, value)` for each pair; false if the lengths do not fit.
template <class Entry>
bool each_metadata(ByteView header, ByteView texts, Entry&& entry) {
  if (header.size == 0) return texts.size == 0;
  if (header.size < metadata_count_size) return false;
  const std::size_t count = get<std::uint16_t>(header.data);
  if (metadata_count_size + metadata_entry_size * count > header.size) return false;
  const std::uint8_t* lengths = header.data + metadata_count_size;
  std::size_t used = 0;
  for (std::size_t i = 0; i < count; ++i, lengths += metadata_entry_size) {
    const std::size_t key = get<std::uint16_t>(lengths), value = get<std::uint32_t>(lengths + 4);
    if (key > texts.size - used || value > texts.size - used - key) return false;
    entry(ByteView{texts.data + used, key}, get<std::uint16_t>(lengths + 2),
          ByteView{texts.data + used + key, value});
    used += key + value;
  }
  return true;
}

std::string text_of(ByteView bytes) { return {reinterpret_cast<const char*>(bytes.data), bytes.size}; }

bool is(const Message& message, std::string_view type) { return message.header.type.view() == type; }

struct ArrayHead {
  std::array<std::uint16_t, 255> shape;
  std::size_t dimensions;
  ByteView data;
};

Drop decode_array_head(const Message& message, std::uint8_t scalar, std::size_t scalar_size,
                       ArrayHead& head) {
  if (!is(message, ndarray_type)) return Drop::wrong_type;
  const ByteView content = message.content;
  if (content.size < 2) return Drop::bad_length;
  if (content.data[0] != scalar) return Drop::bad_scalar;
  head.dimensions = content.data[1];
  const std::size_t head_size = 2 + 2 * head.dimensions;
  if (head.dimensions == 0 || content.size < head_size) return Drop::bad_length;
  for (std::size_t i = 0; i < head.dimensions; ++i)
    head.shape[i] = get<std::uint16_t>(content.data + 2 + 2 * i);
  head.data = {content.data + head_size, content.size - head_size};
  if (head.data.size % scalar_size ||
      !holds(head.shape.data(), head.dimensions, head.data.size / scalar_size))
    return Drop::bad_length;
  return Drop::none;
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

void encode_transform(Bytes& out, const Envelope& envelope, const Transform& transform) {
  require_all_finite("every number of rotation", transform.rotation.data(), 9);
  require_all_finite("every number of position", transform.position.data(), 3);
  append(out, envelope, transform_type, transform_size, [&](std::uint8_t* at) {
    for (int column = 0; column < 3; ++column)  // the message holds columns
      for (int row = 0; row < 3; ++row, at += 4) put_float(at, transform.rotation[3 * row + column]);
    for (int row = 0; row < 3; ++row, at += 4) put_float(at, transform.position[row]);
  });
}

void encode_sensor(Bytes& out, const Envelope& envelope, const double* values, std::size_t count,
                   std::uint64_t unit) {
  if (count > 255) refuse("number of values", "at most 255", double(count));
  require_all_finite("every value", values, count);
  append(out, envelope, sensor_type, sensor_head_size + 8 * count, [&](std::uint8_t* at) {
    at[0] = std::uint8_t(count);
    at[1] = 0;
    put(at + 2, unit);
    at += sensor_head_size;
    for (std::size_t i = 0; i < count; ++i, at += 8) put_float(at, values[i]);
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
    for (std::size_t i = 0; i < count; ++i, at += 8) put_float(at, values[i]);
  });
}

void encode_ndarray_float64(Bytes& out, const Envelope& envelope, const double* values, std::size_t count) {
  if (count > 65535) refuse("number of values in one dimension", "at most 65535", double(count));
  const auto length = std::uint16_t(count);
  encode_ndarray_float64(out, envelope, values, count, &length, 1);
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
  message = Message{header, 0, body, {}, {}};
  if (body.size != header.body_size) return Drop::bad_length;
  if (header.version == 1) return Drop::none;
  if (body.size < extended_header_size) return Drop::bad_extended_header;
  const std::size_t extended = get<std::uint16_t>(body.data);
  const std::size_t keys = get<std::uint16_t>(body.data + 2), values = get<std::uint32_t>(body.data + 4);
  if (extended < extended_header_size || extended > body.size) return Drop::bad_extended_header;
  if (keys > body.size - extended || values > body.size - extended - keys) return Drop::bad_extended_header;
  const std::size_t content = body.size - extended - keys - values;
  message.message_id = get<std::uint32_t>(body.data + 8);
  message.content = {body.data + extended, content};
  message.metadata_header = {body.data + extended + content, keys};
  message.metadata = {body.data + extended + content + keys, values};
  const bool fits =
      each_metadata(message.metadata_header, message.metadata, [](ByteView, std::uint16_t, ByteView) {});
  return fits ? Drop::none : Drop::bad_metadata;
}

Drop read_metadata(const Message& message, std::vector<MetadataEntry>& entries) {
  entries.clear();
  const bool fits = each_metadata(message.metadata_header, message.metadata,
                                  [&](ByteView key, std::uint16_t encoding, ByteView value) {
                                    entries.push_back({text_of(key), text_of(value), encoding});
                                  });
  return fits ? Drop::none : Drop::bad_metadata;
}

Drop decode_transform(const Message& message, Transform& transform) {
  if (!is(message, transform_type)) return Drop::wrong_type;
  if (message.content.size != transform_size) return Drop::bad_length;
  const std::uint8_t* at = message.content.data;
  bool finite = true;
  for (int column = 0; column < 4; ++column) {
    for (int row = 0; row < 3; ++row, at += 4) {
      const float value = get_float<float>(at);
      finite = finite && std::isfinite(value);
      (column < 3 ? transform.rotation[3 * row + column] : transform.position[row]) = value;
    }
  }
  return finite ? Drop::none : Drop::not_finite;
}

Drop decode_sensor(const Message& message, Sensor& sensor) {
  if (!is(message, sensor_type)) return Drop::wrong_type;
  const ByteView content = message.content;
  if (content.size < sensor_head_size || content.size != sensor_head_size + 8 * std::size_t(content.data[0]))
    return Drop::bad_length;
  sensor.unit = get<std::uint64_t>(content.data + 2);
  sensor.values.resize(content.data[0]);
  bool finite = true;
  for (std::size_t i = 0; i < sensor.values.size(); ++i) {
    sensor.values[i] = get_float<double>(content.data + sensor_head_size + 8 * i);
    finite = finite && std::isfinite(sensor.values[i]);
  }
  return finite ? Drop::none : Drop::not_finite;
}

Drop decode_ndarray_float64(const Message& message, Ndarray& array) {
  ArrayHead head;
  const Drop reason = decode_array_head(message, scalar_float64, 8, head);
  if (reason != Drop::none) return reason;
  array.shape.assign(head.shape.begin(), head.shape.begin() + head.dimensions);
  array.values.resize(head.data.size / 8);
  for (std::size_t i = 0; i < array.values.size(); ++i)
    array.values[i] = get_float<double>(head.data.data + 8 * i);
  return Drop::none;
}

Drop decode_ndarray_uint8(const Message& message, ByteView& bytes) {
  ArrayHead head;
  const Drop reason = decode_array_head(message, scalar_uint8, 1, head);
  if (reason != Drop::none) return reason;
  if (head.data.size < byte_string_prefix) return Drop::bad_length;
  const std::uint64_t length = get<std::uint64_t>(head.data.data);
  if (length > head.data.size - byte_string_prefix) return Drop::bad_length;
  bytes = {head.data.data + byte_string_prefix, std::size_t(length)};
  return Drop::none;
}

}  // namespace burrlab::openigtlink
