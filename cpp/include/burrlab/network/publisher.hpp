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

#include "burrlab/copy_under.hpp"
#include "burrlab/network/message_framer.hpp"
#include "burrlab/network/openigtlink.hpp"
#include "burrlab/network/replica_protocol.hpp"
#include "burrlab/network/tcp_server.hpp"
#include "burrlab/network/vrpn.hpp"
#include "burrlab/session/follower.hpp"

namespace burrlab {

/// The newest messages of a stream in memory of fixed size: one per tick, and others between ticks. A place
/// in the stream is the number of bytes before it, from the first byte ever appended.
class TickLog {
 public:
  /// Holds the last `ticks` ticks, if they fit into `bytes`.
  TickLog(std::size_t bytes, std::size_t ticks, std::uint64_t first_tick);

  void append_tick(openigtlink::ByteView message);  ///< of tick `next()`
  void append(openigtlink::ByteView message);       ///< between two ticks
  void restart(std::uint64_t tick);                 ///< drops all; the next tick is `tick`

  std::uint64_t next() const { return next_; }  ///< index of the next tick
  std::uint64_t begin() const;                  ///< of the first byte held
  std::uint64_t end() const { return end_; }    ///< after the last byte
  /// The place after the message of tick `tick` - 1; false if it is no longer held, or not yet there.
  bool place_of(std::uint64_t tick, std::uint64_t& place) const;
  /// Appends at most `most` of the bytes held from `place` on.
  std::size_t copy(std::uint64_t place, std::size_t most, openigtlink::Bytes& out) const;

 private:
  openigtlink::Bytes ring_;
  std::vector<std::uint64_t> places_;  // of the last ticks, by index
  std::uint64_t first_, next_, begin_ = 0, end_ = 0;
};

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

/// A listener for `Follower::add`. The follower's thread only appends to two logs of fixed size; the
/// publisher's own thread sends from them.
class Publisher : public TickListener {
 public:
  /// Listens at once. Throws std::invalid_argument if the address or a setting cannot be used.
  Publisher(Follower& follower, const PublisherSettings& settings);
  ~Publisher() override { stop(); }

  int port() const { return server_.port(); }  ///< 0: none
  int vrpn_port() const { return vrpn_ ? vrpn_->server.port() : 0; }
  const PublisherSettings& settings() const { return settings_; }
  std::uint64_t session() const { return session_; }  ///< random number that names the session
  PublisherStatus status() const { return copy_under(mutex_, status_); }

  /// To be called after the follower was stopped. Tells the replicas the reason, the last tick and its
  /// digest, waits at most `linger` [s] until they have it, and stops.
  void finish(Follower& follower, const std::string& reason, bool failed, double linger = 2.0);
  void stop();  ///< closes all connections

  void on_tick(const TickRecord& record) override;
  void on_digest(std::uint64_t tick, const Hash128& digest) override;
  void on_rebuild(std::uint64_t tick) override;
  void on_bone(FollowedBone& bone) override;
  void on_end() override;

 private:
  struct Peer;
  struct State;
  struct VrpnPort {
    TcpServer server;
    UdpSocket datagrams{server};
    void close() noexcept { server.stop_listening(), datagrams.close(); }
  };
  using Peers = std::vector<std::unique_ptr<Peer>>;

  static std::shared_ptr<const State> take_state(FollowedBone& bone);
  bool may_take_state();
  void run();
  bool accept_all(Peers& peers, TcpServer& server);  // false: the system has no room
  bool admit(Peers& peers, std::unique_ptr<Peer> peer);
  void call_back(Peers& peers);  // VRPN's clients that ask for it
  bool read(Peer& peer);         // false: the connection must be closed; also the next two
  bool write(Peer& peer);
  bool refill(Peer& peer);
  bool refill_standard(Peer& peer);
  bool refill_vrpn(Peer& peer);
  std::uint64_t next_ticks(Peer& peer, const TickLog& log);
  void tell_standard();
  void encode_vrpn(const TickRecord& record, std::uint64_t timestamp);
  bool refill_replica(Peer& peer);
  void hear(Peer& peer, const openigtlink::Message& message);
  void hear(Peer& peer, const vrpn::Message& message);
  void say_force(Peer& peer, std::string_view name);
  void serve(Peer& peer, const replica_protocol::Word& word);
  bool give_state(Peer& peer);
  void say_idle(Peer& peer);
  void leave(std::unique_ptr<Peer>& peer, std::int64_t now);
  void count_peers(const Peers& peers);

  PublisherSettings settings_;
  std::uint64_t session_;
  std::uint32_t burrs_ = 1;
  double period_ = 1.0;  // [ms]
  TcpServer server_;
  std::unique_ptr<VrpnPort> vrpn_;
  std::int64_t last_calls_ = 0;  // the second in which `calls_` requests were read [ns]
  std::size_t calls_ = 0;
  std::atomic<bool> stopping_{false}, waking_{false};
  std::atomic<std::size_t> connected_{0};

  mutable std::mutex mutex_;  // of all below, held briefly; the haptic loop never takes it
  replica_protocol::Hello hello_;
  TickLog log_{1, 1, 0}, poses_{1, 1, 0}, vrpn_log_{1, 1, 0};  // for replicas, standard peers, VRPN's
  std::uint64_t digest_tick_ = 0;
  openigtlink::Bytes scratch_;
  TickRecord newest_;
  std::array<Quaternion, most_burrs> last_turn_{};  // orientations of the last tick
  bool wants_state_ = false, ended_ = false;
  std::shared_ptr<const State> state_;  // of the bone, for waiting replicas; at the end the last one
  std::vector<std::weak_ptr<const State>> states_;  // all that some peer still needs
  std::int64_t last_state_ = 0;                     // [ns]
  std::vector<std::int64_t> missing_;  // end of the wait for each replica that may come (back) [ns]
  replica_protocol::End end_;
  PublisherStatus status_;

  std::mutex life_mutex_;  // of the thread, which never takes it
  std::thread thread_;     // the last member: it uses the others
};

}  // namespace burrlab
