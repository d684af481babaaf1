// What several threads read and one changes, behind a mutex.
#pragma once

#include <mutex>

namespace burrlab {

/// A copy of the value, made under the mutex that guards it.
template <class Value>
Value copy_under(std::mutex& mutex, const Value& value) {
  const std::lock_guard<std::mutex> lock(mutex);
  return value;
}

}  // namespace burrlab
