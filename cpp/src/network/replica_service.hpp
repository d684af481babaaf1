// A published session for its replicas: every tick in order, and the bone where a replica has missed some.
#pragma once

#include "network/replica_protocol.hpp"
#include "published_session.hpp"

namespace burrlab {

class ReplicaStream;

/// Used under the session's mutex, unless it says otherwise.
class ReplicaService {
 public:
  ReplicaService(PublishedSession& session, const FollowedBone& bone);

  std::uint64_t session_number() const { return hello_.session; }  ///< random; without the mutex, too
  void append_tick(const TickRecord& record);
  void append_digest(std::uint64_t tick, const Hash128& digest);
  void restart(std::uint64_t tick) { log_.restart(tick); }
  std::uint64_t next_tick() const { return log_.next(); }

  /// Takes the bone's state if a replica waits for it. In the follower's thread, without the mutex.
  void take_awaited_state(FollowedBone& bone);
  /// Replicas that have all ticks get the end, others this last state. Without the mutex.
  void end(FollowedBone& bone, const std::string& reason, bool failed);
  /// Whether a replica is connected, or may come back soon.
  bool awaits_replicas() const { return !streams_.empty() || !missing_.empty(); }

  /// Answers a peer's first word with the hello, and returns its stream; null if it wants no ticks.
  std::unique_ptr<ReplicaStream> answer(Peer& peer, const replica_protocol::Word& word);
  std::uint64_t replicas() const { return streams_.size(); }
  void forget_lost_replicas();  ///< to be called often

 private:
  friend class ReplicaStream;

  /// The bricks that differ from the initial volume after `tick` ticks.
  struct State {
    std::uint64_t tick = 0;
    std::string digest;
    std::vector<std::uint32_t> bricks;
    std::vector<std::uint8_t> levels;  // q and p of each
  };

  static std::shared_ptr<const State> take_state(FollowedBone& bone);
  bool may_take_state();
  template <class Content>
  void append(openigtlink::Bytes& out, const Content& content) const {
    encode(out, session_.settings.header_version, content);
  }

  PublishedSession& session_;
  replica_protocol::Hello hello_;
  TickLog log_;
  std::uint64_t digest_tick_;
  openigtlink::Bytes bytes_;
  std::vector<ReplicaStream*> streams_;  // of all connected replicas
  bool wants_state_ = false;
  std::shared_ptr<const State> state_;  // of the bone, for waiting replicas; at the end the last one
  std::vector<std::weak_ptr<const State>> states_;  // all that some replica still needs
  std::int64_t last_state_ = 0;                     // [ns]
  std::vector<std::int64_t> missing_;  // end of the wait for each replica that may come (back) [ns]
  replica_protocol::End end_;
};

/// What one replica gets.
class ReplicaStream {
 public:
  ReplicaStream(ReplicaService& service, Peer& peer, const replica_protocol::Word& word);
  ~ReplicaStream();

  bool take(const replica_protocol::Word& word);  ///< false: of no use
  void refill();                                  // these three as of `Peer`
  void leave();
  bool too_slow() const;
  bool wants_state() const { return wants_state_; }

 private:
  bool begin_state();
  void append_bricks();
  void append_idle();

  ReplicaService& service_;
  Peer& peer_;
  std::uint64_t held_tick_;  // ticks of the bone that the replica came with
  std::uint64_t place_ = 0;  // in the log
  bool caught_up_ = false, wants_state_ = false;
  bool suspect_ = false;                                // wants the state as well as its missing ticks
  std::shared_ptr<const ReplicaService::State> state_;  // to be sent at `state_place_`
  std::uint64_t state_place_ = 0;
  std::size_t next_brick_ = 0;
  bool told_end_ = false, left_ = false;
};

}  // namespace burrlab
