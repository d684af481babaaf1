// Sends force zero to a device's service when the program that sends the forces falls silent.
#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <string>
#include <thread>

namespace burrlab {

/// Its thread needs no Python: it acts while other code holds the interpreter. All messages of the connection
/// must go through `send`, so that two writers do not mix.
class ForceWatchdog {
 public:
  /// Of a connected socket, which it duplicates. `rest`: a whole message with force zero, sent once when no
  /// `beat` came for `silence` [ms]. Throws InvalidArgument if that is not positive or it is no socket.
  ForceWatchdog(int socket, std::string rest, double silence);
  ~ForceWatchdog();

  /// Sends a whole message; false if the connection ended, or took nothing for a second: then for good.
  bool send(const std::string& message) noexcept;
  /// The program lives. Returns whether `rest` was sent since the last call.
  bool beat() noexcept;

 private:
  void watch() noexcept;

  int socket_;
  std::string rest_;
  std::int64_t silence_;  // [ns]
  std::atomic<std::int64_t> beat_;
  std::atomic<bool> rested_{false}, stopping_{false};
  bool broken_ = false;
  std::mutex mutex_;  // of a message
  std::thread thread_;
};

}  // namespace burrlab
