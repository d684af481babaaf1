#include "network/force_watchdog.hpp"

#include <algorithm>
#include <cmath>

#include "network/tcp_server.hpp"
#include "require.hpp"
#include "session/realtime.hpp"
#include "socket_options.hpp"

namespace burrlab {

constexpr int send_limit = 1000;                                    // [ms]
constexpr std::int64_t least_pause = 500000, most_pause = 5000000;  // between two looks [ns]

ForceWatchdog::ForceWatchdog(int socket, std::string rest, double silence)
    : rest_(std::move(rest)), beat_(steady_now()) {
  require_positive("silence", silence);
  silence_ = std::llround(std::min(silence, 1e9) * 1e6);
  socket_ = duplicate_socket(socket);
  if (socket_ < 0) refuse("socket", "connected", socket);
  set_options(socket_);  // no message waits for others
  thread_ = std::thread([this] { watch(); });
}

ForceWatchdog::~ForceWatchdog() {
  stopping_.store(true, std::memory_order_release);
  thread_.join();
  close_socket(socket_);
}

bool ForceWatchdog::send(const std::string& message) noexcept {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto* bytes = reinterpret_cast<const std::uint8_t*>(message.data());
  for (std::size_t left = message.size(); left && !broken_;) {
    pollfd waiting = polled_for(socket_, POLLOUT);
    const long sent = poll(&waiting, 1, send_limit) > 0 ? TcpServer::send(socket_, bytes, left) : -1;
    broken_ = sent < 0;  // what follows half a message would be misread
    bytes += std::max(sent, 0L);
    left -= std::size_t(std::max(sent, 0L));
  }
  return !broken_;
}

bool ForceWatchdog::beat() noexcept {
  beat_.store(steady_now(), std::memory_order_release);
  return rested_.exchange(false, std::memory_order_acq_rel);
}

void ForceWatchdog::watch() noexcept {
  RealtimeRequest request;
  request.lock_memory = false;
  become_realtime(request);
  const std::int64_t pause = std::clamp(silence_ / 8, least_pause, most_pause);
  while (!stopping_.load(std::memory_order_acquire)) {
    sleep_until(steady_now() + pause);
    const std::int64_t silent = steady_now() - beat_.load(std::memory_order_acquire);
    if (silent > silence_ && !rested_.exchange(true, std::memory_order_acq_rel)) send(rest_);
  }
}

}  // namespace burrlab
