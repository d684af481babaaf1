// The newest value of one writer, for any number of readers. Nobody waits.
#pragma once

#include <atomic>
#include <cstdint>
#include <cstring>
#include <type_traits>

namespace burrlab {

template <class Value>
class Latest {
  static_assert(std::is_trivially_copyable_v<Value> && sizeof(Value) % 8 == 0);
  static constexpr std::size_t words = sizeof(Value) / 8;

 public:
  Latest() { put(Value{}); }

  void put(const Value& value) noexcept {  ///< one thread at a time
    std::uint64_t image[words];
    std::memcpy(image, &value, sizeof value);
    const std::uint64_t next = version_.load(std::memory_order_relaxed) + 1;
    version_.store(next, std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_release);
    for (std::size_t i = 0; i < words; ++i) word_[i].store(image[i], std::memory_order_relaxed);
    version_.store(next + 1, std::memory_order_release);
  }

  /// False if the writer interfered `tries` times; `value` is then unchanged.
  bool get(Value& value, int tries = 16) const noexcept {
    std::uint64_t image[words];
    for (; tries > 0; --tries) {
      const std::uint64_t before = version_.load(std::memory_order_acquire);
      if (before & 1) continue;
      for (std::size_t i = 0; i < words; ++i) image[i] = word_[i].load(std::memory_order_relaxed);
      std::atomic_thread_fence(std::memory_order_acquire);
      if (version_.load(std::memory_order_relaxed) != before) continue;
      std::memcpy(&value, image, sizeof value);
      return true;
    }
    return false;
  }

 private:
  std::atomic<std::uint64_t> version_{0};
  std::atomic<std::uint64_t> word_[words];
};

}  // namespace burrlab
