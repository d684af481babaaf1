// Messages into bytes. The room is made first, the body written in place, its checksum last.
#include <algorithm>
#include <cmath>

#include "big_endian.hpp"
#include "burrlab/check.hpp"
#include "burrlab/network/openigtlink.hpp"
#include "wire.hpp"

namespace burrlab::openigtlink {
namespace {

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

/// Writes all but the content, which `write(at)` does, then the checksum.
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

}  // namespace

void encode_transform(Bytes& out, const Envelope& envelope, const Transform& transform) {
  require_all_finite("every number of rotation", transform.rotation.data(), 9);
  require_all_finite("every number of position", transform.position.data(), 3);
  append(out, envelope, transform_type, transform_size, [&](std::uint8_t* at) {
    for (int column = 0; column < 3; ++column)  // the message holds columns
      for (int row = 0; row < 3; ++row, at += 4) put_float32(at, transform.rotation[3 * row + column]);
    for (int row = 0; row < 3; ++row, at += 4) put_float32(at, transform.position[row]);
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
    for (std::size_t i = 0; i < count; ++i, at += 8) put_float64(at, values[i]);
  });
}

void encode_ndarray_float64(Bytes& out, const Envelope& envelope, const double* values, std::size_t count,
                            const std::uint16_t* shape, std::size_t dimensions) {
  if (dimensions < 1 || dimensions > 255) refuse("number of dimensions", "1 to 255", double(dimensions));
  if (!holds(shape, dimensions, count)) refuse("product of shape", "the number of values", double(count));
  append(out, envelope, ndarray_type, 2 + 2 * dimensions + 8 * count, [&](std::uint8_t* at) {
    at[0] = scalar_float64;
    at[1] = std::uint8_t(dimensions);
    at += 2;
    for (std::size_t i = 0; i < dimensions; ++i, at += 2) put(at, shape[i]);
    for (std::size_t i = 0; i < count; ++i, at += 8) put_float64(at, values[i]);
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
  append(out, envelope, ndarray_type, 2 + 2 * dimensions + rows * columns, [&](std::uint8_t* at) {
    at[0] = scalar_uint8;
    at[1] = std::uint8_t(dimensions);
    at += 2;
    if (dimensions == 2) {
      put(at, std::uint16_t(rows));
      at += 2;
    }
    put(at, std::uint16_t(columns));
    put(at + 2, std::uint64_t(bytes.size));
    std::copy(bytes.data, bytes.data + bytes.size, at + 2 + byte_string_prefix);
  });
}

}  // namespace burrlab::openigtlink
