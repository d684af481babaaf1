// Cuts a stream of bytes from a socket into messages.
#pragma once

#include <functional>

#include "burrlab/network/openigtlink.hpp"

namespace burrlab::openigtlink {

struct Counters {
  std::uint64_t messages = 0;                         ///< accepted
  std::array<std::uint64_t, drop_reasons> dropped{};  ///< by reason
  std::uint64_t operator[](Drop reason) const { return dropped[std::size_t(reason)]; }
  std::uint64_t all_dropped() const;
};

/// Holds at most one message: header and `largest_body` bytes.
///
/// A message of an unknown type or too long is skipped without being stored; one with a wrong checksum is
/// dropped. After a header that cannot be one, the place in the stream is lost: `broken` is true, nothing
/// more is read, and the connection must be made anew.
class MessageFramer {
 public:
  /// Called with each intact TRANSFORM, SENSOR or NDARRAY; must not throw.
  using Receive = std::function<void(const Message&)>;

  explicit MessageFramer(std::size_t largest_body = std::size_t(1) << 20);

  /// False if the stream is broken.
  bool feed(ByteView bytes, const Receive& receive);
  bool broken() const { return broken_; }
  /// For a new connection; an incomplete message counts as truncated.
  void restart();

  /// Counts each complete header once, as a message or by the reason it was dropped.
  const Counters& counters() const { return counters_; }
  std::size_t memory() const { return buffer_.capacity(); }  ///< [bytes]

 private:
  void drop(Drop reason) { ++counters_.dropped[std::size_t(reason)]; }
  bool fill(ByteView& bytes, std::size_t target);
  void begin_body();
  void finish(const Receive& receive);

  std::size_t largest_body_;
  Bytes buffer_;  // the message so far, in the first `held_` bytes
  std::size_t held_ = 0;
  std::uint64_t skip_ = 0;  // bytes still to skip
  bool in_body_ = false, broken_ = false;
  Header header_;
  Counters counters_;
};

}  // namespace burrlab::openigtlink
