// The newest messages of a stream, one a tick with others between them, in memory that is made once.
#pragma once

#include <cstdint>

#include "burrlab/network/openigtlink.hpp"

namespace burrlab {

/// Bytes are counted from the first one that was ever appended; readers keep such a place for themselves.
class TickLog {
 public:
  /// Holds the last `ticks` ticks, as long as they fit into `bytes`.
  TickLog(std::size_t bytes, std::size_t ticks, std::uint64_t first_tick);

  void append_tick(openigtlink::ByteView message);  ///< of tick `next()`
  void append(openigtlink::ByteView message);       ///< of something between two ticks
  void restart(std::uint64_t tick);                 ///< forgets all; tick `tick` is the next

  std::uint64_t next() const { return next_; }  ///< index of the next tick
  std::uint64_t begin() const;                  ///< place of the first byte that is held
  std::uint64_t end() const { return end_; }    ///< place after the last byte
  /// The place where what follows on tick `tick` - 1 begins; false where that is not held any more, or not
  /// yet.
  bool place_of(std::uint64_t tick, std::uint64_t& place) const;
  /// Appends up to `most` bytes that are held from `place` on.
  std::size_t copy(std::uint64_t place, std::size_t most, openigtlink::Bytes& out) const;

 private:
  openigtlink::Bytes ring_;
  std::vector<std::uint64_t> places_;  // of the last ticks, by index
  std::uint64_t first_, next_, begin_ = 0, end_ = 0;
};

}  // namespace burrlab
