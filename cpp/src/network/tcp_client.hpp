// A TCP connection to a server. One thread makes it, as often as needed; any thread may stop it.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "network/tcp_server.hpp"

namespace burrlab {

constexpr double first_pause = 0.1, longest_pause = 1.0;  ///< of a client between connections [s]

class TcpClient {
 public:
  /// Looks `host` up. Throws InvalidArgument if it has no address or `port` is not 1 to 65535.
  TcpClient(const std::string& host, int port);
  ~TcpClient() { close(); }

  /// Tries each address for `timeout` [s]; false if none answers or the client was stopped.
  bool connect(double timeout = 1.0);
  /// Asks a VRPN server by UDP to connect to this machine, and waits for it; only that server is let in.
  bool ask_for_connection(double timeout = 1.0);
  /// Awaits UDP packets of the server, at the address of the connection; returns the port, 0 if there is
  /// none.
  int open_datagrams(std::string& address);
  /// Waits for bytes, at most `timeout` [s] (below 0: without limit); 0 if none came, the connection ended or
  /// the client was stopped. With `datagram`, also for a UDP packet, and tells which it was.
  std::size_t receive(std::uint8_t* into, std::size_t room, double timeout = -1.0, bool* datagram = nullptr);
  /// Sends all bytes; false if the connection ended, the client was stopped or `timeout` [s] passed.
  bool send(const std::uint8_t* bytes, std::size_t size, double timeout = 1.0);
  /// Sends what the system takes at once, and returns how much that is.
  std::size_t send_some(const std::uint8_t* bytes, std::size_t size);
  void close();
  /// Sends these bytes, even if stopped, and gives the server 1 s to read them and to close: a connection
  /// closed on bytes that were not read is reset, and what was sent may be lost.
  void close_after(const std::uint8_t* bytes, std::size_t size);
  /// Waits [s]; false if the client was stopped.
  bool pause(double seconds);

  /// Stops for good, from any thread; whatever waits returns at once.
  void stop();
  bool stopped() const { return stopped_.load(std::memory_order_acquire); }

 private:
  enum class Wait { ready, stopped, timeout };
  Wait wait(short events, double seconds) const;  // seconds < 0: without limit
  bool connect_to(const PeerAddress& address, double timeout);

  std::vector<PeerAddress> addresses_;
  int socket_ = -1, datagrams_ = -1;
  WakePipe pipe_;  // woken: stopped
  std::atomic<bool> stopped_{false};
};

}  // namespace burrlab
