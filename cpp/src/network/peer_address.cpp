#include "network/peer_address.hpp"

#include "burrlab/error.hpp"
#include "socket_options.hpp"

namespace burrlab {

static_assert(sizeof(sockaddr_in) <= 28 && sizeof(sockaddr_in6) <= 28 &&
              offsetof(sockaddr_in, sin_port) == 2 && offsetof(sockaddr_in6, sin6_port) == 2);

PeerAddress PeerAddress::with_port(int port) const {
  PeerAddress other = *this;
  other.bytes[2] = std::uint8_t(port >> 8);
  other.bytes[3] = std::uint8_t(port);
  return other;
}

std::string PeerAddress::host() const {
  char text[64] = "";
  with_sockaddr(*this, [&](int, const sockaddr* at, socklen_t length) {
    return ::getnameinfo(at, length, text, sizeof text, nullptr, 0, NI_NUMERICHOST);
  });
  return text;
}

bool PeerAddress::is_ipv4() const {
  return with_sockaddr(*this, [](int family, const sockaddr*, socklen_t) { return family == AF_INET; });
}

std::vector<PeerAddress> look_up(const std::string& host, int port, bool to_listen) {
  start_sockets();
  addrinfo hints{}, *list = nullptr;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = to_listen ? AI_PASSIVE : 0;
  const int error = ::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &list);
  if (error) {
    const std::string rule =
        to_listen ? "an address of this machine" : "a name or an address that can be looked up";
    throw InvalidArgument("host must be " + rule + ", got '" + host + "': " + ::gai_strerror(error));
  }
  std::vector<PeerAddress> addresses;
  for (const addrinfo* at = list; at; at = at->ai_next) {
    PeerAddress& address = addresses.emplace_back();
    address.size = std::min<std::size_t>(at->ai_addrlen, address.bytes.size());
    std::memcpy(address.bytes.data(), at->ai_addr, address.size);
  }
  ::freeaddrinfo(list);
  return addresses;
}

WakePipe::WakePipe() {
  start_sockets();
  if (pipe(ends_)) throw RuntimeError("no pipe could be made: " + text_of(last_error()));
  for (const int end : ends_) set_flags(end);
}

WakePipe::~WakePipe() {
  for (const int end : ends_) close_socket(end);
}

void WakePipe::wake() noexcept {
  const char byte = 0;
  if (write(ends_[1], &byte, 1) != 1) return;  // a full pipe wakes as well
}

void WakePipe::drain() noexcept {
  char bytes[64];
  while (read(ends_[0], bytes, sizeof bytes) == sizeof bytes) {
  }
}

}  // namespace burrlab
