// Sizes and names of the wire format that encoders and decoders share.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>

namespace burrlab::openigtlink {

constexpr std::string_view transform_type = "TRANSFORM", sensor_type = "SENSOR", ndarray_type = "NDARRAY";
// The document of version 3 draws 14 bytes; its library, 3D Slicer and pyigtl send 12: two lengths of 16
// bits, the metadata's of 32, the message's id.
constexpr std::size_t extended_header_size = 12;
constexpr std::size_t metadata_count_size = 2, metadata_entry_size = 8;
constexpr std::size_t transform_size = 48, sensor_head_size = 10, byte_string_prefix = 8;
constexpr std::uint8_t scalar_uint8 = 3, scalar_float64 = 11;

/// Whether an array of this shape has `count` elements; safe against overflow.
inline bool holds(const std::uint16_t* shape, std::size_t dimensions, std::uint64_t count) {
  std::uint64_t product = 1;
  for (std::size_t i = 0; i < dimensions; ++i)
    if (shape[i] == 0) return count == 0;
  for (std::size_t i = 0; i < dimensions; ++i) {
    if (product > count / shape[i]) return false;
    product *= shape[i];
  }
  return product == count;
}

}  // namespace burrlab::openigtlink
