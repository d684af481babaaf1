// Addresses of peers and of this machine, and a pipe that wakes a thread which waits for sockets.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace burrlab {

/// An IPv4 or IPv6 address with a port.
struct PeerAddress {
  std::array<std::uint8_t, 28> bytes{};  // a sockaddr_in or sockaddr_in6
  std::size_t size = 0;                  ///< 0: none

  int port() const { return bytes[2] << 8 | bytes[3]; }  // at the same place in both kinds
  PeerAddress with_port(int port) const;
  std::string host() const;  ///< as numbers
  bool is_ipv4() const;
};

/// Addresses of a host, to connect to or, if `to_listen`, of this machine. Throws InvalidArgument if
/// there is none.
std::vector<PeerAddress> look_up(const std::string& host, int port, bool to_listen);

/// Ends the waiting of a thread for sockets, from any other.
class WakePipe {
 public:
  WakePipe();
  ~WakePipe();
  WakePipe(const WakePipe&) = delete;
  WakePipe& operator=(const WakePipe&) = delete;
  int socket() const { return ends_[0]; }  ///< readable once woken
  void wake() noexcept;
  void drain() noexcept;

 private:
  int ends_[2] = {-1, -1};
};

}  // namespace burrlab
