#include "network/tick_log.hpp"

#include <algorithm>
#include <cstring>

#include "require.hpp"

namespace burrlab {

using openigtlink::Bytes;
using openigtlink::ByteView;

TickLog::TickLog(std::size_t bytes, std::size_t ticks, std::uint64_t first_tick)
    : ring_(bytes), places_(ticks + 1), first_(first_tick), next_(first_tick) {
  if (bytes < 1) refuse("bytes of a log", "at least 1", 0.0);
  if (ticks < 1) refuse("ticks of a log", "at least 1", 0.0);
  restart(first_tick);
}

void TickLog::restart(std::uint64_t tick) {
  first_ = next_ = tick;
  begin_ = end_;
  places_[tick % places_.size()] = end_;
}

void TickLog::append_tick(ByteView message) {
  append(message);
  ++next_;
  places_[next_ % places_.size()] = end_;
}

void TickLog::append(ByteView message) {
  if (message.size > ring_.size()) refuse("length of a message in a log", "at most the log's", message.size);
  const std::size_t at = std::size_t(end_ % ring_.size());
  const std::size_t head = std::min(message.size, ring_.size() - at);
  std::memcpy(ring_.data() + at, message.data, head);
  std::memcpy(ring_.data(), message.data + head, message.size - head);
  end_ += message.size;
}

std::uint64_t TickLog::begin() const {
  return end_ > ring_.size() ? std::max<std::uint64_t>(begin_, end_ - ring_.size()) : begin_;
}

bool TickLog::place_of(std::uint64_t tick, std::uint64_t& place) const {
  if (tick < first_ || tick > next_ || next_ - tick >= places_.size()) return false;
  place = places_[tick % places_.size()];
  return place >= begin();
}

std::size_t TickLog::copy(std::uint64_t place, std::size_t most, Bytes& out) const {
  if (place < begin() || place > end_) return 0;
  const std::size_t size = std::size_t(std::min<std::uint64_t>(most, end_ - place));
  const std::size_t at = std::size_t(place % ring_.size());
  const std::size_t head = std::min(size, ring_.size() - at);
  out.insert(out.end(), ring_.data() + at, ring_.data() + at + head);
  out.insert(out.end(), ring_.data(), ring_.data() + (size - head));
  return size;
}

}  // namespace burrlab
