#include "burrlab/session/record_ring.hpp"

#include <cstring>

#include "require.hpp"

namespace burrlab {

RecordRing::RecordRing(std::size_t capacity) : slots_(capacity) {
  if (capacity < 2) refuse("capacity", "at least 2", double(capacity));
  for (Slot& slot : slots_)  // touches the memory here, not in the loop
    for (auto& word : slot.word) word.store(0, std::memory_order_relaxed);
}

// A slot tells its record's number before and after its words are read, so a reader notices the writer.
void RecordRing::push(const TickRecord& record) noexcept {
  const std::uint64_t number = count_.load(std::memory_order_relaxed);
  Slot& slot = slots_[number % slots_.size()];
  std::uint64_t image[words];
  std::memcpy(image, &record, sizeof record);
  slot.holds.store(0, std::memory_order_relaxed);
  std::atomic_thread_fence(std::memory_order_release);
  for (std::size_t i = 0; i < words; ++i) slot.word[i].store(image[i], std::memory_order_relaxed);
  slot.holds.store(number + 1, std::memory_order_release);
  count_.store(number + 1, std::memory_order_release);
}

bool RecordRing::read(std::uint64_t number, TickRecord& record) const noexcept {
  if (number >= count_.load(std::memory_order_acquire)) return false;
  const Slot& slot = slots_[number % slots_.size()];
  if (slot.holds.load(std::memory_order_acquire) != number + 1) return false;
  std::uint64_t image[words];
  for (std::size_t i = 0; i < words; ++i) image[i] = slot.word[i].load(std::memory_order_relaxed);
  std::atomic_thread_fence(std::memory_order_acquire);
  if (slot.holds.load(std::memory_order_relaxed) != number + 1) return false;
  std::memcpy(&record, image, sizeof record);
  return true;
}

}  // namespace burrlab
