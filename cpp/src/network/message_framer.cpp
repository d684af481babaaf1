#include "burrlab/network/message_framer.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>

#include "burrlab/check.hpp"
#include "wire.hpp"

namespace burrlab::openigtlink {

std::uint64_t Counters::all_dropped() const {
  return std::accumulate(dropped.begin(), dropped.end(), std::uint64_t(0));
}

MessageFramer::MessageFramer(std::size_t largest_body) : largest_body_(largest_body) {
  if (largest_body < transform_size) refuse("largest_body", "at least 48 bytes", double(largest_body));
  if (std::uint64_t(largest_body) >> 32) refuse("largest_body", "below 4 GiB", double(largest_body));
}

/// Takes bytes until `target` are held. The buffer grows with the bytes received, whatever a header says.
bool MessageFramer::fill(ByteView& bytes, std::size_t target) {
  const std::size_t taken = std::min(target - held_, bytes.size);
  const std::size_t needed = held_ + taken;
  if (buffer_.size() < needed) {
    const std::size_t room = std::min(std::max(2 * buffer_.size(), needed), header_size + largest_body_);
    buffer_.reserve(room);
    buffer_.resize(room);
  }
  if (taken) std::memcpy(buffer_.data() + held_, bytes.data, taken);
  held_ = needed;
  bytes = {bytes.data + taken, bytes.size - taken};
  return held_ == target;
}

void MessageFramer::begin_body() {
  Drop reason = decode_header({buffer_.data(), held_}, header_);
  if (reason != Drop::none) {
    broken_ = true;
    held_ = 0;
    drop(reason);
    return;
  }
  const std::string_view type = header_.type.view();
  if (type != transform_type && type != sensor_type && type != ndarray_type)
    reason = Drop::unknown_type;
  else if (header_.body_size > largest_body_)
    reason = Drop::oversized;
  if (reason == Drop::none) {
    in_body_ = true;
    return;
  }
  drop(reason);
  skip_ = header_.body_size;
  held_ = 0;
}

void MessageFramer::finish(const Receive& receive) {
  in_body_ = false;
  held_ = 0;
  const ByteView body{buffer_.data() + header_size, std::size_t(header_.body_size)};
  Message message;
  const Drop reason = crc64(body) == header_.crc ? decode_body(header_, body, message) : Drop::bad_crc;
  if (reason != Drop::none) return drop(reason);
  ++counters_.messages;
  receive(message);
}

bool MessageFramer::feed(ByteView bytes, const Receive& receive) {
  while (!broken_) {
    const std::size_t passed = std::size_t(std::min<std::uint64_t>(skip_, bytes.size));
    skip_ -= passed;
    bytes = {bytes.data + passed, bytes.size - passed};
    if (skip_) break;
    if (in_body_) {
      if (!fill(bytes, header_size + std::size_t(header_.body_size))) break;
      finish(receive);
    } else {
      if (!fill(bytes, header_size)) break;
      begin_body();
    }
  }
  return !broken_;
}

void MessageFramer::restart() {
  if (held_) drop(Drop::truncated);
  held_ = 0;
  skip_ = 0;
  in_body_ = broken_ = false;
}

}  // namespace burrlab::openigtlink
