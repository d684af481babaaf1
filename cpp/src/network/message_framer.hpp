// Cuts a stream of bytes from a socket into messages.
#pragma once

#include <algorithm>
#include <functional>
#include <utility>

#include "network/openigtlink.hpp"

namespace burrlab::openigtlink {

struct Counters {
  std::uint64_t messages = 0;                         ///< accepted
  std::array<std::uint64_t, drop_reasons> dropped{};  ///< by reason
  std::uint64_t operator[](Drop reason) const { return dropped[std::size_t(reason)]; }
  std::uint64_t all_dropped() const;
};

/// Cuts the stream of any wire into heads of one size, each with a body, and counts. Holds at most one
/// message: a head and `largest_body` bytes.
///
/// After a head that cannot be one, the place in the stream is lost: `broken` is true, nothing more is read,
/// and the connection must be made anew.
class StreamCutter {
 public:
  bool broken() const { return broken_; }
  /// For a new connection; an incomplete message counts as truncated.
  void restart();
  /// Counts each complete head once, as a message or by the reason it was dropped.
  const Counters& counters() const { return counters_; }
  std::size_t memory() const { return buffer_.capacity(); }  ///< [bytes]

 protected:
  StreamCutter(std::size_t head, std::size_t largest_body) : head_(head), largest_body_(largest_body) {}

  /// Calls `begin` with each head, which calls `await_body`, `skip_body` or `break_off`, or lets another head
  /// follow; then `finish` with the body. False if the stream is broken.
  template <class Begin, class Finish>
  bool cut(ByteView bytes, Begin&& begin, Finish&& finish) {
    while (!broken_) {
      const std::size_t passed = std::size_t(std::min<std::uint64_t>(skip_, bytes.size));
      skip_ -= passed;
      bytes = {bytes.data + passed, bytes.size - passed};
      if (skip_ || !fill(bytes, head_ + body_)) break;
      const bool whole = in_body_;
      if (!whole) begin(ByteView{buffer_.data(), head_});
      if (in_body_ && body_ > 0 && !whole) continue;
      const ByteView body{buffer_.data() + head_, body_};
      held_ = body_ = 0;
      if (std::exchange(in_body_, false)) finish(body);
    }
    return !broken_;
  }
  void await_body(std::size_t body) { in_body_ = true, body_ = body; }
  void skip_body(Drop reason, std::uint64_t body) { count_drop(reason), skip_ = body; }
  void break_off(Drop reason) { count_drop(reason), broken_ = true; }
  void count_drop(Drop reason) { ++counters_.dropped[std::size_t(reason)]; }
  std::size_t largest_body() const { return largest_body_; }

  Counters counters_;

 private:
  bool fill(ByteView& bytes, std::size_t target);

  std::size_t head_, largest_body_;
  Bytes buffer_;  // the message so far, in the first `held_` bytes
  std::size_t held_ = 0, body_ = 0;
  std::uint64_t skip_ = 0;  // bytes still to skip
  bool in_body_ = false, broken_ = false;
};

/// A message of an unknown type or too long is skipped without being stored; one with a wrong checksum is
/// dropped.
class MessageFramer : public StreamCutter {
 public:
  /// Called with each intact TRANSFORM, SENSOR, NDARRAY or GET_STRING; must not throw.
  using Receive = std::function<void(const Message&)>;

  explicit MessageFramer(std::size_t largest_body = std::size_t(1) << 20);

  /// False if the stream is broken.
  bool feed(ByteView bytes, const Receive& receive);

 private:
  void begin_body(ByteView head);
  void finish(ByteView body, const Receive& receive);

  Header header_;
};

}  // namespace burrlab::openigtlink
