#include "network/tcp_client.hpp"

#include "require.hpp"

#include <algorithm>

#include "session/realtime.hpp"
#include "socket_options.hpp"

namespace burrlab {

constexpr int client_send_buffer = 8192;  // what a client sends is little [bytes]

static bool is_of_host(const PeerAddress& peer, const PeerAddress& server) {
  return peer.with_port(0).host() == server.with_port(0).host();
}

TcpClient::TcpClient(const std::string& host, int port) {
  if (port < 1 || port > 65535) refuse("port", "1 to 65535", port);
  addresses_ = look_up(host, port, false);
}

TcpClient::Wait TcpClient::wait(short events, double seconds) const {
  const std::int64_t end = steady_after(seconds);
  pollfd waiting[3] = {polled_for(pipe_.socket(), POLLIN), polled_for(socket_, events),
                       polled_for(datagrams_, POLLIN)};
  const int count = !events ? 1 : datagrams_ < 0 ? 2 : 3;
  for (;;) {
    const std::int64_t left = (end - steady_now()) / 1000000 + 1;
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

bool TcpClient::ask_for_connection(double timeout) {
  close();
  for (const PeerAddress& server : addresses_) {
    if (!server.is_ipv4()) continue;  // VRPN knows IPv4 only
    const int asking = with_sockaddr(server, [](int family, const sockaddr* at, socklen_t size) {
      const int socket = int(::socket(family, SOCK_DGRAM, 0));
      if (socket >= 0) ::connect(socket, at, size);
      return socket;
    });
    if (asking < 0) return false;
    set_flags(asking);
    // At the address of this machine that the server can reach.
    const int listener = bound_socket(address_of(asking, ::getsockname).with_port(0), SOCK_STREAM);
    const PeerAddress here = address_of(listener, ::getsockname);
    const std::string text = here.host() + " " + std::to_string(here.port());
    if (listener >= 0 && ::listen(listener, 4) == 0 && ::send(asking, text.c_str(), text.size() + 1, 0) > 0) {
      socket_ = listener;
      while (socket_ == listener && wait(POLLIN, timeout) == Wait::ready) {
        const int caller = int(::accept(listener, nullptr, nullptr));
        if (caller >= 0 && is_of_host(address_of(caller, ::getpeername), server))
          socket_ = caller;
        else if (caller >= 0)
          close_socket(caller);
      }
      if (socket_ == listener) socket_ = -1;
    }
    if (listener >= 0) close_socket(listener);
    close_socket(asking);
    if (socket_ < 0) continue;
    set_flags(socket_);
    set_options(socket_);
    return true;
  }
  return false;
}

int TcpClient::open_datagrams(std::string& address) {
  const PeerAddress here = address_of(socket_, ::getsockname);
  address = here.host();
  datagrams_ = here.is_ipv4() ? bound_socket(here.with_port(0), SOCK_DGRAM) : -1;
  return datagrams_ < 0 ? 0 : address_of(datagrams_, ::getsockname).port();
}

std::size_t TcpClient::receive(std::uint8_t* into, std::size_t room, double timeout, bool* datagram) {
  while (socket_ >= 0 && wait(POLLIN, timeout) == Wait::ready) {
    if (datagram && datagrams_ >= 0) {
      PeerAddress from;
      const long got = receive_from(datagrams_, into, room, from);
      *datagram = got > 0 && is_of_host(from, address_of(socket_, ::getpeername));
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
  TcpServer::close(std::exchange(socket_, -1));
  TcpServer::close(std::exchange(datagrams_, -1));
}

void TcpClient::close_after(const std::uint8_t* bytes, std::size_t size) {
  const std::int64_t end = steady_after(1.0);
  pollfd waiting = polled_for(socket_, POLLIN | POLLOUT);
  std::uint8_t unread[4096];
  while (socket_ >= 0 && steady_now() < end && poll(&waiting, 1, 100) >= 0) {
    const long sent = size ? TcpServer::send(socket_, bytes, size) : 0;
    if (sent < 0 || TcpServer::receive(socket_, unread, sizeof unread) < 0) break;
    bytes += sent;
    size -= std::size_t(sent);
    if (size) continue;
    ::shutdown(socket_, 1);  // SHUT_WR, SD_SEND
    waiting.events = POLLIN;
  }
  close();
}

bool TcpClient::pause(double seconds) { return wait(0, seconds) != Wait::stopped; }

void TcpClient::stop() {
  if (stopped_.exchange(true, std::memory_order_acq_rel)) return;
  pipe_.wake();
}

}  // namespace burrlab
