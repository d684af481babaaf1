// Copies of a value that several threads share behind a mutex.
#pragma once

#include <mutex>

namespace burrlab {

/// A copy of the value, made while holding the mutex.
template <class Value>
Value copy_under(std::mutex& mutex, const Value& value) {
  const std::lock_guard<std::mutex> lock(mutex);
  return value;
}

}  // namespace burrlab
