// Numbers and texts written into a byte string and read back, big-endian; a reader never goes past the end.
#pragma once

#include <string>
#include <string_view>

#include "big_endian.hpp"
#include "burrlab/network/openigtlink.hpp"

namespace burrlab::openigtlink {

class ByteWriter {
 public:
  explicit ByteWriter(Bytes& out) : out_(out) {}

  template <class Unsigned>
  ByteWriter& number(Unsigned value) {
    out_.resize(out_.size() + sizeof value);
    put(out_.data() + out_.size() - sizeof value, value);
    return *this;
  }
  ByteWriter& bytes(const std::uint8_t* data, std::size_t size) {
    out_.insert(out_.end(), data, data + size);
    return *this;
  }
  ByteWriter& text(std::string_view text) {
    return bytes(reinterpret_cast<const std::uint8_t*>(text.data()), text.size());
  }

 private:
  Bytes& out_;
};

/// False from the first thing on that was not there.
class ByteReader {
 public:
  explicit ByteReader(ByteView bytes) : left_(bytes) {}

  template <class Unsigned>
  ByteReader& number(Unsigned& value) {
    ByteView view;
    if (bytes(sizeof value, view).ok_) value = get<Unsigned>(view.data);
    return *this;
  }
  ByteReader& bytes(std::size_t size, ByteView& view) {
    ok_ = ok_ && size <= left_.size;
    if (!ok_) return *this;
    view = {left_.data, size};
    left_ = {left_.data + size, left_.size - size};
    return *this;
  }
  ByteReader& text(std::size_t size, std::string& text) {
    ByteView view;
    if (bytes(size, view).ok_) text.assign(reinterpret_cast<const char*>(view.data), size);
    return *this;
  }
  ByteReader& rest(std::string& text) { return this->text(left_.size, text); }
  std::size_t left() const { return left_.size; }
  bool ok() const { return ok_; }
  bool ended() const { return ok_ && left_.size == 0; }

 private:
  ByteView left_;
  bool ok_ = true;
};

}  // namespace burrlab::openigtlink
