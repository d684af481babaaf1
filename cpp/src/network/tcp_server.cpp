#include "burrlab/network/tcp_server.hpp"

#include "burrlab/check.hpp"

#include <algorithm>
#include <cstddef>
#include <cstring>

#include "socket_options.hpp"

namespace burrlab {

TcpServer::TcpServer(const std::string& host, int port, int send_buffer) {
  if (port < -1 || port > 65535) refuse("port", "0 to 65535", port);
  start_sockets();
  if (port >= 0) listen(host, port, send_buffer);
  if (pipe(wake_)) {
    close(socket_);
    throw std::runtime_error("no pipe could be made: " + text_of(last_error()));
  }
  set_flags(wake_[0]);
  set_flags(wake_[1]);
}

TcpServer::~TcpServer() {
  for (const int descriptor : {socket_, wake_[0], wake_[1]}) close(descriptor);
}

void TcpServer::listen(const std::string& host, int port, int send_buffer) {
  addrinfo hints{}, *found = nullptr;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE;
  const int error = ::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found);
  if (error)
    throw std::invalid_argument("host must be an address of this machine, got '" + host +
                                "': " + ::gai_strerror(error));
  int reason = 0;
  for (const addrinfo* at = found; at && socket_ < 0; at = at->ai_next) {
    socket_ = int(::socket(at->ai_family, SOCK_STREAM, 0));
    if (socket_ < 0) continue;
    set_flags(socket_);
    set_option(socket_, SOL_SOCKET, own_port, 1);
    set_option(socket_, SOL_SOCKET, SO_SNDBUF, send_buffer);  // accepted sockets inherit it
    if (::bind(socket_, at->ai_addr, socklen_t(at->ai_addrlen)) == 0 && ::listen(socket_, 128) == 0) break;
    reason = last_error();
    close(socket_);
    socket_ = -1;
  }
  ::freeaddrinfo(found);
  if (socket_ < 0)
    throw std::invalid_argument("host and port must be free to listen on, got " + host + ":" +
                                std::to_string(port) + ": " + text_of(reason));
  sockaddr_storage address{};
  socklen_t size = sizeof address;
  ::getsockname(socket_, reinterpret_cast<sockaddr*>(&address), &size);
  port_ = ntohs(address.ss_family == AF_INET6 ? reinterpret_cast<const sockaddr_in6&>(address).sin6_port
                                              : reinterpret_cast<const sockaddr_in&>(address).sin_port);
}

void TcpServer::stop_listening() noexcept {
  close(socket_);
  socket_ = -1;
}

bool TcpServer::wait(std::vector<Interest>& interests, bool accepting, int milliseconds) {
  polled_.resize((interests.size() + 2) * sizeof(pollfd));
  auto* polled = reinterpret_cast<pollfd*>(polled_.data());
  polled[0] = polled_for(wake_[0], POLLIN);
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
  char drained[64];
  while (polled[0].revents && read(wake_[0], drained, sizeof drained) == sizeof drained) {
  }
  return polled[1].revents != 0;
}

void TcpServer::wake() noexcept {
  const char byte = 0;
  if (write(wake_[1], &byte, 1) != 1) return;  // a full pipe wakes as well
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

PeerAddress PeerAddress::with_port(int port) const {
  PeerAddress other = *this;
  other.bytes[2] = std::uint8_t(port >> 8);  // in both kinds of address
  other.bytes[3] = std::uint8_t(port);
  return other;
}

namespace {

static_assert(sizeof(sockaddr_in) <= 28 && sizeof(sockaddr_in6) <= 28 &&
              offsetof(sockaddr_in, sin_port) == 2 && offsetof(sockaddr_in6, sin6_port) == 2);

/// Calls `fill(sockaddr*, socklen_t*)`, which writes an address.
template <class Fill>
auto filled(PeerAddress& address, Fill&& fill) {
  sockaddr_storage storage{};
  socklen_t size = sizeof storage;
  const auto result = fill(reinterpret_cast<sockaddr*>(&storage), &size);
  address.size = std::min<std::size_t>(size, address.bytes.size());
  std::memcpy(address.bytes.data(), &storage, address.size);
  return result;
}

template <class Use>
auto used(const PeerAddress& address, Use&& use) {
  sockaddr_storage storage{};
  std::memcpy(&storage, address.bytes.data(), address.size);
  return use(storage.ss_family, reinterpret_cast<const sockaddr*>(&storage), socklen_t(address.size));
}

}  // namespace

int TcpServer::connect(const PeerAddress& address, int send_buffer) noexcept {
  return used(address, [&](int family, const sockaddr* at, socklen_t size) {
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

PeerAddress TcpServer::peer_of(int socket) noexcept {
  PeerAddress address;
  filled(address, [&](sockaddr* at, socklen_t* size) { return ::getpeername(socket, at, size); });
  return address;
}

/// Only an own address can be bound.
bool TcpServer::is_own(const PeerAddress& address) noexcept {
  return used(address.with_port(0), [](int family, const sockaddr* at, socklen_t size) {
    const int socket = int(::socket(family, SOCK_DGRAM, 0));
    const bool own = socket < 0 || ::bind(socket, at, size) == 0;
    close(socket);
    return own;
  });
}

UdpSocket::UdpSocket(const TcpServer& beside) {
  PeerAddress address;
  filled(address, [&](sockaddr* at, socklen_t* size) { return ::getsockname(beside.socket(), at, size); });
  const int failed = used(address, [&](int family, const sockaddr* at, socklen_t size) {
    socket_ = int(::socket(family, SOCK_DGRAM, 0));
    return socket_ < 0 ? -1 : ::bind(socket_, at, size);
  });
  if (failed) {
    const std::string reason = text_of(last_error());
    TcpServer::close(socket_);
    throw std::invalid_argument("port must be free for UDP too, got " + std::to_string(beside.port()) + ": " +
                                reason);
  }
  set_flags(socket_);
}

long UdpSocket::receive(std::uint8_t* into, std::size_t room, PeerAddress& from) noexcept {
  return filled(from, [&](sockaddr* at, socklen_t* size) {
    return long(::recvfrom(socket_, reinterpret_cast<char*>(into), room, 0, at, size));
  });
}

bool UdpSocket::send(const PeerAddress& to, const std::uint8_t* bytes, std::size_t size) noexcept {
  return used(to, [&](int, const sockaddr* at, socklen_t length) {
    return ::sendto(socket_, reinterpret_cast<const char*>(bytes), size, MSG_NOSIGNAL, at, length) ==
           long(size);
  });
}

}  // namespace burrlab
