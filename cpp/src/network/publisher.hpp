// The leader's side of the network: a server that sends a follower's ticks to standard OpenIGTLink peers, to
// replicas and to VRPN clients. Nobody waits for a peer.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "network/message_framer.hpp"
#include "network/tcp_server.hpp"
#include "session/follower.hpp"

namespace burrlab {

struct PublisherSettings {
  std::string host = "127.0.0.1";                  ///< address to listen on, without authentication
  int port = 0;                                    ///< of OpenIGTLink; 0: any free port, -1: none
  std::string hello = "{}";                        ///< JSON about the session, for replicas
  int header_version = 1;                          ///< 1 or 2
  bool sensor = true;                              ///< the force as SENSOR too
  double log = 10.0;                               ///< ticks kept for replicas [s]
  std::size_t most_peers = 32;                     ///< connections at once
  std::size_t most_behind = std::size_t(1) << 19;  ///< a replica farther behind is cut off [bytes]
  std::uint64_t thin_after = 100;  ///< a standard peer farther behind gets only the newest [ticks]
  int vrpn = -1;                   ///< port of VRPN, TCP and UDP; 0: any free port, -1: none
};

/// Counts since the start, except the first three.
struct PublisherStatus {
  std::uint64_t tick = 0;             ///< ticks sent or ready to be sent
  std::uint64_t standard_peers = 0;   ///< connected, or not known yet to be replicas; VRPN's clients too
  std::uint64_t replicas = 0;         ///< connected
  std::uint64_t accepted = 0;         ///< connections
  std::uint64_t refused = 0;          ///< connections beyond `most_peers`
  std::uint64_t skipped = 0;          ///< ticks that slow standard peers missed
  std::uint64_t cut_off = 0;          ///< slow replicas
  std::uint64_t stalled = 0;          ///< peers that took nothing for 5 s, or VRPN clients that did not greet
  std::uint64_t hellos = 0;           ///< asked only for the hello, or had another session or volume
  std::uint64_t by_ticks = 0;         ///< replicas that continued from the log
  std::uint64_t by_bricks = 0;        ///< replicas that got bricks
  std::uint64_t bad_words = 0;        ///< malformed, of replicas; their connections are closed
  std::uint64_t ignored = 0;          ///< intact messages without use here
  std::uint64_t framing_lost = 0;     ///< connections closed because the framing was lost
  std::uint64_t too_many_faults = 0;  ///< connections closed after 16 dropped messages
  std::uint64_t out_of_range = 0;     ///< positions too far for a TRANSFORM
  std::uint64_t bytes_sent = 0;
  std::uint64_t vrpn_peers = 0;    ///< connected VRPN clients
  std::uint64_t vrpn_others = 0;   ///< VRPN clients of another minor version
  std::uint64_t vrpn_calls = 0;    ///< connections begun because a VRPN client asked for it by UDP
  std::uint64_t datagrams = 0;     ///< UDP packets sent
  openigtlink::Counters received;  ///< messages of all peers, and drops by reason
};

struct PublishedSession;
class IgtlService;
class ReplicaService;
class VrpnService;
class Peer;

/// A listener for `Follower::add`. The follower's thread makes the bytes of each tick once, for all peers,
/// and appends them to logs of fixed size; the publisher's own thread sends from them to all peers.
class Publisher : public TickListener {
 public:
  /// Listens at once; the follower must outlive it. Throws InvalidArgument if the address or a setting
  /// cannot be used.
  Publisher(Follower& follower, const PublisherSettings& settings);
  ~Publisher() override;

  int port() const { return server_.port(); }  ///< 0: none
  int vrpn_port() const;                       ///< 0: none
  const PublisherSettings& settings() const;
  std::uint64_t session() const;  ///< random number that names the session
  PublisherStatus status() const;

  /// To be called after the follower was stopped. Tells the replicas the reason, the last tick and its
  /// digest, waits at most `linger` [s] until they have it, and stops.
  void finish(const std::string& reason, bool failed, double linger = 2.0);
  void stop();  ///< closes all connections

  void on_tick(const TickRecord& record) override;
  void on_digest(std::uint64_t tick, const Hash128& digest) override;
  void on_rebuild(std::uint64_t tick) override;
  void on_bone(FollowedBone& bone) override;
  void on_end() override;

 private:
  using Peers = std::vector<std::unique_ptr<Peer>>;

  void log_newest();
  void run();
  bool accept_all(Peers& peers, TcpServer& server);  // false: the system has no room
  bool admit(Peers& peers, std::unique_ptr<Peer> peer);
  bool read(Peer& peer);  // false: the connection must be closed
  bool write(Peer& peer);
  void count_peers(const Peers& peers);

  Follower& follower_;
  TcpServer server_;
  std::unique_ptr<PublishedSession> session_;
  std::unique_ptr<ReplicaService> replicas_;
  std::unique_ptr<IgtlService> igtl_;
  std::unique_ptr<VrpnService> vrpn_;  // if a port is set
  std::atomic<bool> stopping_{false}, waking_{false};
  std::atomic<std::size_t> connected_{0};
  std::mutex life_mutex_;  // of the thread, which never takes it
  std::thread thread_;     // the last member: it uses the others
};

}  // namespace burrlab
