// Bytes into messages: every length is checked before it is used.
#include <cmath>

#include "big_endian.hpp"
#include "burrlab/network/openigtlink.hpp"
#include "wire.hpp"

namespace burrlab::openigtlink {
namespace {

/// Calls `entry(key, encoding, value)` for each pair; false where the lengths do not fit.
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
      const float value = get_float32(at);
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
    sensor.values[i] = get_float64(content.data + sensor_head_size + 8 * i);
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
  for (std::size_t i = 0; i < array.values.size(); ++i) array.values[i] = get_float64(head.data.data + 8 * i);
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
