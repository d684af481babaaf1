// The wire format: sizes, names, numbers in network byte order, and byte strings.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <type_traits>

#include "network/openigtlink.hpp"

namespace burrlab::openigtlink {

constexpr std::string_view transform_type = "TRANSFORM", sensor_type = "SENSOR", ndarray_type = "NDARRAY";
constexpr std::string_view string_type = "STRING", get_string_type = "GET_STRING";
// The document of version 3 draws 14 bytes; its library, 3D Slicer and pyigtl send 12: two lengths of 16
// bits, the metadata's of 32, the message's id.
constexpr std::size_t extended_header_size = 12;
constexpr std::size_t metadata_count_size = 2;
constexpr std::size_t transform_size = 48, sensor_head_size = 10, byte_string_prefix = 8;
constexpr std::uint16_t us_ascii = 3;  // IANA
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

template <class Number>
using WordOf = std::conditional_t<sizeof(Number) == 8, std::uint64_t, std::uint32_t>;

/// A number, or an enumeration, in network byte order, on any machine.
template <class Number>
Number get(const std::uint8_t* at) {
  WordOf<Number> word = 0;
  for (std::size_t i = 0; i < sizeof(Number); ++i) word = word << 8 | at[i];
  Number value = Number(word);
  if constexpr (std::is_floating_point_v<Number>) std::memcpy(&value, &word, sizeof value);
  return value;
}

template <class Number>
void put(std::uint8_t* at, Number value) {
  WordOf<Number> word;
  if constexpr (std::is_floating_point_v<Number>)
    std::memcpy(&word, &value, sizeof word);
  else
    word = WordOf<Number>(value);
  for (std::size_t i = 0; i < sizeof(Number); ++i)
    at[i] = std::uint8_t(word >> (8 * (sizeof(Number) - 1 - i)));
}

/// Writes numbers and texts, big-endian, to a byte string; ByteReader reads them and never passes the end.
class ByteWriter {
 public:
  explicit ByteWriter(Bytes& out) : out_(out) {}

  template <class Number>
  ByteWriter& number(Number value) {
    out_.resize(out_.size() + sizeof value);
    put(out_.data() + out_.size() - sizeof value, value);
    return *this;
  }
  ByteWriter& bytes(const std::uint8_t* data, std::size_t size) {
    out_.insert(out_.end(), data, data + size);
    return *this;
  }
  ByteWriter& text(std::string_view text, std::size_t = 0) {
    return bytes(reinterpret_cast<const std::uint8_t*>(text.data()), text.size());
  }
  ByteWriter& rest(std::string_view text) { return this->text(text); }
  ByteWriter& rest(ByteView view) { return bytes(view.data, view.size); }

 private:
  Bytes& out_;
};

/// False from the first missing item on.
class ByteReader {
 public:
  explicit ByteReader(ByteView bytes) : left_(bytes) {}

  template <class Number>
  ByteReader& number(Number& value) {
    ByteView view;
    if (bytes(sizeof value, view).ok_) value = get<Number>(view.data);
    return *this;
  }
  ByteReader& bytes(std::size_t size, ByteView& view) {
    ok_ = ok_ && size <= left_.size;
    if (!ok_) return *this;
    view = {left_.data, size};
    left_ = {left_.data + size, left_.size - size};
    return *this;
  }
  ByteReader& text(std::string& text, std::size_t size) {
    ByteView view;
    if (bytes(size, view).ok_) text.assign(reinterpret_cast<const char*>(view.data), size);
    return *this;
  }
  ByteReader& rest(std::string& text) { return this->text(text, left_.size); }
  ByteReader& rest(ByteView& view) { return bytes(left_.size, view); }
  std::size_t left() const { return left_.size; }
  bool ok() const { return ok_; }
  bool ended() const { return ok_ && left_.size == 0; }

 private:
  ByteView left_;
  bool ok_ = true;
};

}  // namespace burrlab::openigtlink
