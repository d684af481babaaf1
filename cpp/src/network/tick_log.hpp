// The stream that a publisher sends, in memory of fixed size.
#pragma once

#include <vector>

#include "network/openigtlink.hpp"

namespace burrlab {

/// The newest messages of a stream in memory of fixed size: one per tick, and others between ticks. A place
/// in the stream is the number of bytes before it, from the first byte ever appended.
class TickLog {
 public:
  /// Holds the last `ticks` ticks, if they fit into `bytes`.
  TickLog(std::size_t bytes, std::size_t ticks, std::uint64_t first_tick);

  void append_tick(openigtlink::ByteView message);  ///< of tick `next()`
  void append(openigtlink::ByteView message);       ///< between two ticks
  void restart(std::uint64_t tick);                 ///< drops all; the next tick is `tick`

  std::uint64_t next() const { return next_; }  ///< index of the next tick
  std::uint64_t begin() const;                  ///< of the first byte held
  std::uint64_t end() const { return end_; }    ///< after the last byte
  /// The place after the message of tick `tick` - 1; false if it is no longer held, or not yet there.
  bool place_of(std::uint64_t tick, std::uint64_t& place) const;
  /// Appends at most `most` of the bytes held from `place` on.
  std::size_t copy(std::uint64_t place, std::size_t most, openigtlink::Bytes& out) const;

 private:
  openigtlink::Bytes ring_;
  std::vector<std::uint64_t> places_;  // of the last ticks, by index
  std::uint64_t first_, next_, begin_ = 0, end_ = 0;
};

}  // namespace burrlab
