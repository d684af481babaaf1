#include "burrlab/network/tcp_client.hpp"

#include "burrlab/check.hpp"

#include <algorithm>
#include <chrono>
#include <cstring>

#include "socket_options.hpp"

namespace burrlab {

namespace {

constexpr int client_send_buffer = 8192;  // what a client sends is little [bytes]

/// The IPv4 address of one end of a socket; no port if there is none.
template <class Name>
sockaddr_in address_of(int socket, Name name) {
  sockaddr_in address{};
  socklen_t size = sizeof address;
  if (name(socket, reinterpret_cast<sockaddr*>(&address), &size) || address.sin_family != AF_INET) return {};
  return address;
}

/// A socket on this address, on any free port, which is then told; -1 if there is none.
int open_at(sockaddr_in& address, int type) {
  const int socket = int(::socket(AF_INET, type, 0));
  if (socket < 0) return -1;
  set_flags(socket);
  address.sin_port = 0;
  ::bind(socket, reinterpret_cast<const sockaddr*>(&address), sizeof address);
  address = address_of(socket, ::getsockname);
  return socket;
}

std::string text_of(const sockaddr_in& address) {
  char text[64] = "";
  ::getnameinfo(reinterpret_cast<const sockaddr*>(&address), sizeof address, text, sizeof text, nullptr, 0,
                NI_NUMERICHOST);
  return text;
}

}  // namespace

TcpClient::TcpClient(const std::string& host, int port) {
  if (port < 1 || port > 65535) refuse("port", "1 to 65535", port);
  start_sockets();
  addrinfo hints{}, *found = nullptr;
  hints.ai_socktype = SOCK_STREAM;
  const std::string service = std::to_string(port);
  const int error = ::getaddrinfo(host.c_str(), service.c_str(), &hints, &found);
  if (error)
    throw std::invalid_argument("host must be a name or an address that can be looked up, got '" + host +
                                "': " + ::gai_strerror(error));
  for (const addrinfo* at = found; at; at = at->ai_next) {
    PeerAddress& address = addresses_.emplace_back();
    address.size = std::min<std::size_t>(at->ai_addrlen, address.bytes.size());
    std::memcpy(address.bytes.data(), at->ai_addr, address.size);
  }
  ::freeaddrinfo(found);
  if (pipe(wake_)) throw std::runtime_error("no pipe could be made: " + text_of(last_error()));
  set_flags(wake_[0]);
  set_flags(wake_[1]);
}

TcpClient::~TcpClient() {
  close();
  close_socket(wake_[0]);
  close_socket(wake_[1]);
}

TcpClient::Wait TcpClient::wait(short events, double seconds) const {
  using Clock = std::chrono::steady_clock;
  const auto end = Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                      std::chrono::duration<double>(seconds < 0 ? 0.0 : seconds));
  pollfd waiting[3] = {polled_for(wake_[0], POLLIN), polled_for(socket_, events),
                       polled_for(datagrams_, POLLIN)};
  const int count = !events ? 1 : datagrams_ < 0 ? 2 : 3;
  for (;;) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - Clock::now()).count() + 1;
    const int ready = poll(waiting, count, seconds < 0 ? -1 : int(left > 0 ? left : 0));
    if (stopped() || (ready > 0 && waiting[0].revents)) return Wait::stopped;
    if (ready > 0) return Wait::ready;
    if (ready == 0 || last_error() != EINTR) return Wait::timeout;
  }
}

bool TcpClient::connect_to(const PeerAddress& address, double timeout) {
  socket_ = TcpServer::connect(address, client_send_buffer);
  if (socket_ < 0 || wait(POLLOUT, timeout) != Wait::ready) return false;
  int error = 0;
  socklen_t size = sizeof error;
  auto* at = reinterpret_cast<char*>(&error);
  return ::getsockopt(socket_, SOL_SOCKET, SO_ERROR, at, &size) == 0 && error == 0;
}

bool TcpClient::connect(double timeout) {
  close();
  for (const PeerAddress& address : addresses_) {
    if (stopped()) return false;
    if (connect_to(address, timeout)) return true;
    close();
  }
  return false;
}

bool TcpClient::be_called(double timeout) {
  close();
  for (const PeerAddress& address : addresses_) {
    sockaddr_in server{};
    if (address.size != sizeof server) continue;  // VRPN knows IPv4 only
    std::memcpy(&server, address.bytes.data(), sizeof server);
    const int ask = int(::socket(AF_INET, SOCK_DGRAM, 0));
    if (ask < 0) return false;
    set_flags(ask);
    ::connect(ask, reinterpret_cast<const sockaddr*>(&server), sizeof server);
    sockaddr_in own = address_of(ask, ::getsockname);  // the one that the server can reach
    const int listener = open_at(own, SOCK_STREAM);
    const std::string text = text_of(own) + " " + std::to_string(ntohs(own.sin_port));
    if (listener >= 0 && ::listen(listener, 4) == 0 && ::send(ask, text.c_str(), text.size() + 1, 0) > 0) {
      socket_ = listener;
      while (socket_ == listener && wait(POLLIN, timeout) == Wait::ready) {
        const int caller = int(::accept(listener, nullptr, nullptr));
        if (caller >= 0 && address_of(caller, ::getpeername).sin_addr.s_addr == server.sin_addr.s_addr)
          socket_ = caller;
        else if (caller >= 0)
          close_socket(caller);
      }
      if (socket_ == listener) socket_ = -1;
    }
    if (listener >= 0) close_socket(listener);
    close_socket(ask);
    if (socket_ < 0) continue;
    set_flags(socket_);
    set_options(socket_);
    return true;
  }
  return false;
}

int TcpClient::open_datagrams(std::string& address) {
  sockaddr_in own = address_of(socket_, ::getsockname);
  address = text_of(own);
  datagrams_ = own.sin_port ? open_at(own, SOCK_DGRAM) : -1;
  return datagrams_ < 0 ? 0 : ntohs(own.sin_port);
}

std::size_t TcpClient::receive(std::uint8_t* into, std::size_t room, double timeout, bool* datagram) {
  while (socket_ >= 0 && wait(POLLIN, timeout) == Wait::ready) {
    if (datagram && datagrams_ >= 0) {
      sockaddr_in from{};
      socklen_t size = sizeof from;
      const auto got = ::recvfrom(datagrams_, reinterpret_cast<char*>(into), room, 0,
                                  reinterpret_cast<sockaddr*>(&from), &size);
      *datagram = got > 0 && from.sin_addr.s_addr == address_of(socket_, ::getpeername).sin_addr.s_addr;
      if (*datagram) return std::size_t(got);
    }
    const long got = TcpServer::receive(socket_, into, room);
    if (got > 0) return std::size_t(got);
    if (got < 0) break;
  }
  return 0;
}

bool TcpClient::send(const std::uint8_t* bytes, std::size_t size, double timeout) {
  while (size && socket_ >= 0) {
    const long sent = TcpServer::send(socket_, bytes, size);
    if (sent < 0 || (sent == 0 && wait(POLLOUT, timeout) != Wait::ready)) return false;
    bytes += sent;
    size -= std::size_t(sent);
  }
  return size == 0;
}

std::size_t TcpClient::send_some(const std::uint8_t* bytes, std::size_t size) {
  return std::size_t(std::max(TcpServer::send(socket_, bytes, size), 0L));
}

void TcpClient::close() {
  for (int* one : {&socket_, &datagrams_}) {
    if (*one >= 0) close_socket(*one);
    *one = -1;
  }
}

void TcpClient::close_after(const std::uint8_t* bytes, std::size_t size) {
  if (socket_ < 0 || !send(bytes, size, 0.0)) return close();
  ::shutdown(socket_, 1);  // SHUT_WR, SD_SEND
  const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(100);
  pollfd waiting = polled_for(socket_, POLLIN);
  std::uint8_t unread[4096];
  while (std::chrono::steady_clock::now() < end && poll(&waiting, 1, 100) > 0)
    if (TcpServer::receive(socket_, unread, sizeof unread) < 0) break;
  close();
}

bool TcpClient::pause(double seconds) { return wait(0, seconds) != Wait::stopped; }

void TcpClient::stop() {
  if (stopped_.exchange(true, std::memory_order_acq_rel)) return;
  const char byte = 0;
  // A byte into an empty pipe cannot fail.
  if (write(wake_[1], &byte, 1) != 1) return;
}

}  // namespace burrlab
