// A listening TCP socket, operations on its connections, and a UDP socket beside it. Only `wait` waits.
#pragma once

#include <utility>

#include "network/peer_address.hpp"

namespace burrlab {

/// A socket of this type (SOCK_STREAM, SOCK_DGRAM) that is bound to an address; -1 if it cannot be.
int bound_socket(const PeerAddress& address, int type) noexcept;
/// A UDP packet and who sent it; below 0: none.
long receive_from(int socket, std::uint8_t* into, std::size_t room, PeerAddress& from) noexcept;

class TcpServer {
 public:
  /// A socket to wait for, and the result.
  struct Interest {
    int socket = -1;
    bool read = false, write = false;         ///< wanted
    bool readable = false, writable = false;  ///< found; an ended connection is readable
  };

  /// Listens; port 0 is any free one, -1 none at all. `send_buffer`: the system's, for each connection
  /// [bytes]. Throws InvalidArgument if the address cannot be used.
  TcpServer(const std::string& host, int port, int send_buffer);
  ~TcpServer() { stop_listening(); }

  int port() const { return port_; }  ///< 0: none
  int socket() const { return socket_; }
  void stop_listening() noexcept { close(std::exchange(socket_, -1)); }  ///< frees the port

  /// Waits at most `milliseconds` for one of these, for `wake`, or, if `accepting`, for a connection. Returns
  /// whether there may be a connection to accept.
  bool wait(std::vector<Interest>& interests, bool accepting, int milliseconds);
  /// Makes `wait` return; from any thread.
  void wake() noexcept { pipe_.wake(); }

  enum class Accepted { connection, none, exhausted };
  /// `exhausted`: the system has no room for another.
  Accepted accept(int& socket);

  /// A connection to a peer, not yet made: it is when the socket is writable; -1 if it cannot be.
  static int connect(const PeerAddress& address, int send_buffer) noexcept;
  static PeerAddress peer_of(int socket) noexcept;
  static bool is_own(const PeerAddress& address) noexcept;  ///< whether it is this machine's, any port

  /// Bytes received or sent; 0 if there is nothing to do, -1 if the connection ended.
  static long receive(int socket, std::uint8_t* into, std::size_t room) noexcept;
  static long send(int socket, const std::uint8_t* bytes, std::size_t size) noexcept;
  static void close(int socket) noexcept;
  static void set_send_buffer(int socket, int bytes) noexcept;  ///< of the system

 private:
  int socket_ = -1, port_ = 0;
  WakePipe pipe_;
  std::vector<unsigned char> polled_;
};

/// A UDP socket at the address and port of a listening TCP socket.
class UdpSocket {
 public:
  explicit UdpSocket(const TcpServer& beside);  ///< throws InvalidArgument if the port is taken
  ~UdpSocket() { close(); }
  UdpSocket(const UdpSocket&) = delete;
  UdpSocket& operator=(const UdpSocket&) = delete;

  int socket() const { return socket_; }
  void close() noexcept { TcpServer::close(std::exchange(socket_, -1)); }
  bool send(const PeerAddress& to, const std::uint8_t* bytes, std::size_t size) noexcept;

 private:
  int socket_ = -1;
};

}  // namespace burrlab
