#include "network/tcp_server.hpp"

#include "require.hpp"

#include "socket_options.hpp"

namespace burrlab {

int bound_socket(const PeerAddress& address, int type) noexcept {
  return with_sockaddr(address, [&](int family, const sockaddr* at, socklen_t size) {
    const int socket = int(::socket(family, type, 0));
    if (socket < 0) return -1;
    set_flags(socket);
    if (type == SOCK_STREAM) set_option(socket, SOL_SOCKET, own_port, 1);
    if (::bind(socket, at, size) == 0) return socket;
    close_socket(socket);
    return -1;
  });
}

TcpServer::TcpServer(const std::string& host, int port, int send_buffer) {
  if (port < -1 || port > 65535) refuse("port", "0 to 65535", port);
  if (port < 0) return;
  int error = 0;
  for (const PeerAddress& address : look_up(host, port, true)) {
    socket_ = bound_socket(address, SOCK_STREAM);
    if (socket_ >= 0) set_option(socket_, SOL_SOCKET, SO_SNDBUF, send_buffer);  // accepted sockets inherit it
    if (socket_ >= 0 && ::listen(socket_, 128) == 0) break;
    error = last_error();
    stop_listening();
  }
  if (socket_ < 0)
    throw InvalidArgument("host and port must be free to listen on, got " + host + ":" +
                          std::to_string(port) + ": " + text_of(error));
  port_ = address_of(socket_, ::getsockname).port();
}

bool TcpServer::wait(std::vector<Interest>& interests, bool accepting, int milliseconds) {
  polled_.resize((interests.size() + 2) * sizeof(pollfd));
  auto* polled = reinterpret_cast<pollfd*>(polled_.data());
  polled[0] = polled_for(pipe_.socket(), POLLIN);
  polled[1] = polled_for(accepting ? socket_ : -1, POLLIN);
  for (std::size_t i = 0; i < interests.size(); ++i) {
    const Interest& interest = interests[i];
    const short events = short((interest.read ? POLLIN : 0) | (interest.write ? POLLOUT : 0));
    polled[i + 2] = polled_for(events ? interest.socket : -1, events);
  }
  const bool any = poll(polled, interests.size() + 2, milliseconds) > 0;
  for (std::size_t i = 0; i < interests.size(); ++i) {
    const short found = any ? polled[i + 2].revents : short(0);
    interests[i].readable = found & (POLLIN | POLLERR | POLLHUP | POLLNVAL);
    interests[i].writable = found & POLLOUT;
  }
  if (!any) return false;
  if (polled[0].revents) pipe_.drain();
  return polled[1].revents != 0;
}

TcpServer::Accepted TcpServer::accept(int& socket) {
  socket = int(::accept(socket_, nullptr, nullptr));
  if (socket < 0) return exhausted(last_error()) ? Accepted::exhausted : Accepted::none;
  set_flags(socket);
  set_options(socket);
  return Accepted::connection;
}

long TcpServer::receive(int socket, std::uint8_t* into, std::size_t room) noexcept {
  const auto got = ::recv(socket, reinterpret_cast<char*>(into), room, 0);
  if (got > 0) return long(got);
  return got < 0 && try_again(last_error()) ? 0 : -1;
}

long TcpServer::send(int socket, const std::uint8_t* bytes, std::size_t size) noexcept {
  const auto sent = ::send(socket, reinterpret_cast<const char*>(bytes), size, MSG_NOSIGNAL);
  if (sent >= 0) return long(sent);
  return try_again(last_error()) ? 0 : -1;
}

void TcpServer::close(int socket) noexcept {
  if (socket >= 0) close_socket(socket);
}

void TcpServer::set_send_buffer(int socket, int bytes) noexcept {
  set_option(socket, SOL_SOCKET, SO_SNDBUF, bytes);
}

int TcpServer::connect(const PeerAddress& address, int send_buffer) noexcept {
  return with_sockaddr(address, [&](int family, const sockaddr* at, socklen_t size) {
    const int socket = int(::socket(family, SOCK_STREAM, 0));
    if (socket < 0) return -1;
    set_flags(socket);
    set_options(socket);
    set_option(socket, SOL_SOCKET, SO_SNDBUF, send_buffer);
    if (::connect(socket, at, size) == 0 || last_error() == connecting) return socket;
    close(socket);
    return -1;
  });
}

PeerAddress TcpServer::peer_of(int socket) noexcept { return address_of(socket, ::getpeername); }

/// Only an own address can be bound.
bool TcpServer::is_own(const PeerAddress& address) noexcept {
  const int socket = bound_socket(address.with_port(0), SOCK_DGRAM);
  close(socket);
  return socket >= 0;
}

UdpSocket::UdpSocket(const TcpServer& beside)
    : socket_(bound_socket(address_of(beside.socket(), ::getsockname), SOCK_DGRAM)) {
  if (socket_ < 0)
    throw InvalidArgument("port must be free for UDP too, got " + std::to_string(beside.port()) + ": " +
                          text_of(last_error()));
}

long receive_from(int socket, std::uint8_t* into, std::size_t room, PeerAddress& from) noexcept {
  return fill_address(from, [&](sockaddr* at, socklen_t* size) {
    return long(::recvfrom(socket, reinterpret_cast<char*>(into), room, 0, at, size));
  });
}

bool UdpSocket::send(const PeerAddress& to, const std::uint8_t* bytes, std::size_t size) noexcept {
  return with_sockaddr(to, [&](int, const sockaddr* at, socklen_t length) {
    return ::sendto(socket_, reinterpret_cast<const char*>(bytes), size, MSG_NOSIGNAL, at, length) ==
           long(size);
  });
}

}  // namespace burrlab
