// Sockets: where Windows differs from POSIX, and options of every socket.
#pragma once

#ifdef _WIN32
#define NOMINMAX 1
#include <ws2tcpip.h>
#undef far  // words of its 16-bit days
#undef near
#else
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>
#endif

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <string>
#include <system_error>

#include "network/peer_address.hpp"

#ifndef MSG_NOSIGNAL
#define MSG_NOSIGNAL 0  // macOS has SO_NOSIGPIPE instead, and Windows no signals
#endif

namespace burrlab {

#ifdef _WIN32

constexpr int connecting = WSAEWOULDBLOCK;
constexpr int own_port = SO_EXCLUSIVEADDRUSE;  // SO_REUSEADDR would let others take the port

inline void start_sockets() {
  WSADATA data;
  ::WSAStartup(MAKEWORD(2, 2), &data);  // where it fails, looking up the host does
}
inline int last_error() { return ::WSAGetLastError(); }
inline bool try_again(int error) { return error == WSAEWOULDBLOCK; }
inline bool exhausted(int error) { return error == WSAEMFILE || error == WSAENOBUFS; }
inline void close_socket(int socket) { ::closesocket(socket); }
inline int duplicate_socket(int socket) {
  WSAPROTOCOL_INFOW info;
  if (::WSADuplicateSocketW(SOCKET(socket), ::GetCurrentProcessId(), &info)) return -1;
  constexpr int any = FROM_PROTOCOL_INFO;
  return int(::WSASocketW(any, any, any, &info, 0, WSA_FLAG_OVERLAPPED | WSA_FLAG_NO_HANDLE_INHERIT));
}

inline void set_flags(int socket) {
  u_long yes = 1;
  ::ioctlsocket(socket, FIONBIO, &yes);
  ::SetHandleInformation(reinterpret_cast<HANDLE>(std::intptr_t(socket)), HANDLE_FLAG_INHERIT, 0);
}

inline int poll(pollfd* sockets, std::size_t count, int milliseconds) {
  return ::WSAPoll(sockets, ULONG(count), milliseconds);
}

/// Pipes cannot be polled here: two connected sockets stand for one.
inline int pipe(int (&ends)[2]) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  auto* at = reinterpret_cast<sockaddr*>(&address);
  int size = sizeof address;
  const SOCKET listener = ::socket(AF_INET, SOCK_STREAM, 0);
  ends[1] = int(::socket(AF_INET, SOCK_STREAM, 0));
  if (::bind(listener, at, size) == 0 && ::listen(listener, 1) == 0 &&
      ::getsockname(listener, at, &size) == 0 && ::connect(ends[1], at, size) == 0)
    ends[0] = int(::accept(listener, nullptr, nullptr));
  ::closesocket(listener);
  return ends[0] < 0;
}
inline int read(int end, char* into, int room) { return ::recv(end, into, room, 0); }
inline int write(int end, const char* bytes, int size) { return ::send(end, bytes, size, 0); }

#else

constexpr int connecting = EINPROGRESS;
constexpr int own_port = SO_REUSEADDR;

inline void start_sockets() {}
inline int last_error() { return errno; }
inline bool try_again(int error) { return error == EAGAIN || error == EWOULDBLOCK || error == EINTR; }
inline bool exhausted(int error) {
  return error == EMFILE || error == ENFILE || error == ENOBUFS || error == ENOMEM;
}
inline void close_socket(int socket) { ::close(socket); }
inline int duplicate_socket(int socket) { return ::fcntl(socket, F_DUPFD_CLOEXEC, 0); }

inline void set_flags(int descriptor) {
  ::fcntl(descriptor, F_SETFL, ::fcntl(descriptor, F_GETFL) | O_NONBLOCK);
  ::fcntl(descriptor, F_SETFD, FD_CLOEXEC);
}

#endif

/// Calls `use(family, sockaddr*, length)`.
template <class Use>
auto with_sockaddr(const PeerAddress& address, Use&& use) {
  sockaddr_storage storage{};
  std::memcpy(&storage, address.bytes.data(), address.size);
  return use(storage.ss_family, reinterpret_cast<const sockaddr*>(&storage), socklen_t(address.size));
}

/// The address that `fill(sockaddr*, socklen_t*)` writes; returns what it returns.
template <class Fill>
auto fill_address(PeerAddress& address, Fill&& fill) {
  sockaddr_storage storage{};
  socklen_t size = sizeof storage;
  const auto status = fill(reinterpret_cast<sockaddr*>(&storage), &size);
  address.size = std::min<std::size_t>(size, address.bytes.size());
  std::memcpy(address.bytes.data(), &storage, address.size);
  return status;
}

/// The address of one end of a socket: `name` is getsockname or getpeername.
template <class Name>
PeerAddress address_of(int socket, Name name) {
  PeerAddress address;
  const int error =
      fill_address(address, [&](sockaddr* at, socklen_t* size) { return name(socket, at, size); });
  return error ? PeerAddress{} : address;
}

inline std::string text_of(int error) { return std::system_category().message(error); }
inline pollfd polled_for(int socket, short events) { return {decltype(pollfd::fd)(socket), events, 0}; }

/// None is needed: failures are ignored.
inline void set_option(int socket, int level, int option, int value) {
  ::setsockopt(socket, level, option, reinterpret_cast<const char*>(&value), sizeof value);
}

/// A peer whose cable was pulled says nothing: the kernel asks after a second, and gives up after three more.
inline void set_options(int socket) {
  set_option(socket, SOL_SOCKET, SO_KEEPALIVE, 1);
  set_option(socket, IPPROTO_TCP, TCP_NODELAY, 1);
#ifdef SO_NOSIGPIPE
  set_option(socket, SOL_SOCKET, SO_NOSIGPIPE, 1);
#endif
#ifdef TCP_KEEPIDLE
  set_option(socket, IPPROTO_TCP, TCP_KEEPIDLE, 1);
  set_option(socket, IPPROTO_TCP, TCP_KEEPINTVL, 1);
  set_option(socket, IPPROTO_TCP, TCP_KEEPCNT, 3);
#endif
}

}  // namespace burrlab
