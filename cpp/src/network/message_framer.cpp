#include "network/message_framer.hpp"

#include <cstring>
#include <numeric>

#include "require.hpp"
#include "wire.hpp"

namespace burrlab::openigtlink {

std::uint64_t Counters::all_dropped() const {
  return std::accumulate(dropped.begin(), dropped.end(), std::uint64_t(0));
}

/// Takes bytes until `target` are held. The buffer grows with the bytes received, whatever a header says.
bool StreamCutter::fill(ByteView& bytes, std::size_t target) {
  const std::size_t taken = std::min(target - held_, bytes.size);
  const std::size_t needed = held_ + taken;
  if (buffer_.size() < needed) {
    const std::size_t room = std::min(std::max(2 * buffer_.size(), needed), head_ + largest_body_);
    buffer_.reserve(room);
    buffer_.resize(room);
  }
  if (taken) std::memcpy(buffer_.data() + held_, bytes.data, taken);
  held_ = needed;
  bytes = {bytes.data + taken, bytes.size - taken};
  return held_ == target;
}

void StreamCutter::restart() {
  if (held_) count_drop(Drop::truncated);
  held_ = body_ = 0;
  skip_ = 0;
  in_body_ = broken_ = false;
}

MessageFramer::MessageFramer(std::size_t largest_body) : StreamCutter(header_size, largest_body) {
  if (largest_body < transform_size) refuse("largest_body", "at least 48 bytes", double(largest_body));
  if (std::uint64_t(largest_body) >> 32) refuse("largest_body", "below 4 GiB", double(largest_body));
}

void MessageFramer::begin_body(ByteView head) {
  const Drop reason = decode_header(head, header_);
  if (reason != Drop::none) return break_off(reason);
  const std::string_view type = header_.type.view();
  if (type != transform_type && type != sensor_type && type != ndarray_type && type != get_string_type)
    skip_body(Drop::unknown_type, header_.body_size);
  else if (header_.body_size > largest_body())
    skip_body(Drop::oversized, header_.body_size);
  else
    await_body(std::size_t(header_.body_size));
}

void MessageFramer::finish(ByteView body, const Receive& receive) {
  Message message;
  const Drop reason = crc64(body) == header_.crc ? decode_body(header_, body, message) : Drop::bad_crc;
  if (reason != Drop::none) return count_drop(reason);
  ++counters_.messages;
  receive(message);
}

bool MessageFramer::feed(ByteView bytes, const Receive& receive) {
  return cut(
      bytes, [this](ByteView head) { begin_body(head); }, [&](ByteView body) { finish(body, receive); });
}

}  // namespace burrlab::openigtlink
