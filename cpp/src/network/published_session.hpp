// What a publisher shares with its three protocols: the session, and the base of their connections.
#pragma once

#include "network/publisher.hpp"
#include "network/tick_log.hpp"
#include "session/realtime.hpp"

namespace burrlab {

constexpr int standard_send_buffer =
    8192;  // of the system: small, so that a slow peer gets no old poses [bytes]
constexpr std::int64_t second = 1000000000;  // [ns]
constexpr std::size_t poses_kept = 1024;     // for peers that are no replicas [ticks]

/// All from `status` on is used under the mutex, which is held briefly; the haptic loop never takes it.
struct PublishedSession {
  PublisherSettings settings;
  std::uint32_t burrs = 1;
  double period = 1.0;  // [ms]
  std::mutex mutex;
  PublisherStatus status;
  TickRecord newest;
  bool ended = false;  // `finish` was called

  /// The names of the burrs as devices of OpenIGTLink and as senders of VRPN.
  std::vector<std::string> burr_names() const;
};

/// One connection. The publisher's thread owns it; calls what a protocol overrides under the session's mutex.
class Peer {
 public:
  explicit Peer(int connection) : socket(connection) {}
  virtual ~Peer() { TcpServer::close(socket); }
  Peer(const Peer&) = delete;
  Peer& operator=(const Peer&) = delete;

  virtual const openigtlink::StreamCutter& cutter() const = 0;
  virtual bool feed(openigtlink::ByteView bytes) = 0;  // false: the framing is lost
  virtual void refill() = 0;                           // appends what there is to send to `pending`
  virtual void leave() {}                              // the connection ended
  virtual bool greeted() const { return true; }        // false: it must say something before it gets ticks
  virtual bool too_slow() const { return false; }      // for the log: it must be closed

  bool idle() const { return sent == pending.size(); }

  int socket;
  bool connecting = false;     // called back, and not yet there
  openigtlink::Bytes pending;  // bytes to send, the first `sent` of them sent
  std::size_t sent = 0;
  bool closing = false;  // once they are sent
  std::int64_t last_progress = steady_now(), last_queued = steady_now(),
               last_allowance = steady_now();  // [ns]
  std::size_t allowance = 65536;               // bytes the peer may still send in this second
};

/// The ticks that a peer gets which need not get all: [`tick`, the returned one). If it is too far behind,
/// the newest alone.
std::uint64_t ticks_to_send(PublishedSession& session, const TickLog& log, std::uint64_t& tick);

}  // namespace burrlab
