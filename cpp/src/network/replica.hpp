// The replica: a bone that follows a leader's ticks over the network and stays equal to the bit.
#pragma once

#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "copy_under.hpp"
#include "network/message_framer.hpp"
#include "network/replica_protocol.hpp"
#include "network/tcp_client.hpp"
#include "session/follower.hpp"

namespace burrlab {

/// Why a connection was given up.
struct ReplicaFault {
  std::uint64_t tick = 0;  ///< ticks executed
  std::uint64_t seen = 0;  ///< tick of the message that showed the fault; else `tick`
  std::string reason;
};

/// A difference between the replica's bone and the leader's.
struct Divergence {
  std::uint64_t tick = 0;             ///< ticks executed when it was found
  std::string what;                   ///< "digest", or a result of a burr: "force of burr 0"
  std::uint64_t compared_at = 0;      ///< ticks executed when the bricks were compared
  bool exact = false;                 ///< the leader's bricks were of the same tick
  std::vector<std::uint32_t> bricks;  ///< that differed; repaired
};

struct ReplicaStatus {
  std::uint64_t tick = 0;         ///< ticks executed
  std::uint64_t connections = 0;  ///< made, with a hello received
  std::uint64_t by_ticks = 0;     ///< connections after the first that continued by ticks
  std::uint64_t by_bricks = 0;    ///< times the bone was set to the leader's
  std::uint64_t digests_equal = 0, digests_different = 0;
  std::uint64_t differing_ticks = 0;  ///< with another force, penetration or removed volume
  std::uint64_t faults = 0;           ///< connections given up
  std::uint64_t most_missed = 0;      ///< most ticks between a loss and the message that showed it
  bool connected = false;
  bool ended = false, failed = false;
  std::string reason;                     ///< of the end
  std::vector<ReplicaFault> last_faults;  ///< at most 1000
  std::vector<Divergence> divergences;    ///< at most 1000
  openigtlink::Counters received;
};

class Replica : public SharedBone {
 public:
  /// Throws InvalidArgument if `host` has no address or `port` is not 1 to 65535.
  Replica(const std::string& host, int port);
  ~Replica() { stop(); }

  /// Asks the leader for its hello for `timeout` [s]; false if none came.
  bool fetch_hello(double timeout);
  const replica_protocol::Hello& hello() const { return hello_; }

  /// Starts to follow, in its own thread. Changes `bone` in place, and holds it until the session ends.
  /// Throws unless the hello was fetched, the bone has its digest and nobody else uses the bone.
  void start(std::shared_ptr<VoxelBone> bone, const SessionSetup& setup,
             std::shared_ptr<AnatomyWatch> watch = nullptr);
  void stop(const std::string& reason = "stopped");
  bool wait(double seconds);  ///< waits for the session's end; returns whether it came

  ReplicaStatus status() const { return copy_under(mutex_, status_); }
  /// Changes since the last call; the first call gives all that differs from the initial volume.
  BoneUpdate take_changed();
  using SharedBone::take_changed;

 private:
  enum class Stage { hello, following };

  void run();
  bool follow();
  bool send_word(replica_protocol::Holds holds);
  void take(const openigtlink::Message& message);
  void take_hello(const replica_protocol::Hello& hello);
  void take_tick(const replica_protocol::TickMessage& tick);
  void take_digest(const replica_protocol::Digest& digest);
  void take_bricks(const replica_protocol::Bricks& bricks);
  void take_end(const replica_protocol::End& end);
  void put_bricks();
  void diverge(const std::string& what);
  void give_up(const std::string& reason, std::uint64_t seen);
  void give_up(const std::string& reason) { give_up(reason, bone_->tick()); }
  void end(const std::string& reason, bool failed);
  FollowedBone& shared() const override;  // throws before `start`

  TcpClient client_;
  replica_protocol::Hello hello_;
  openigtlink::MessageFramer framer_;
  Stage stage_ = Stage::hello;
  bool broken_ = false;     // this connection is given up
  bool progress_ = false;   // this connection was of use, or showed a difference: connect again at once
  bool only_hello_ = true;  // nothing followed the hello yet
  bool any_digest_ = false;
  std::uint64_t digest_tick_ = 0;       // of the last digest
  std::vector<std::uint32_t> numbers_;  // bricks received so far
  std::vector<std::uint8_t> levels_;
  replica_protocol::Bricks incoming_;
  int repairs_ = 0;  // in a row, without success

  // Under the bone's mutex:
  std::unique_ptr<VoxelBone> initial_;
  std::unique_ptr<FollowedBone> bone_;
  std::unique_ptr<VoxelBone::Changing> changing_;  // until the session ends
  bool suspect_ = false;
  Divergence divergence_;           // found; its bricks are not known yet
  std::optional<BoneView> unseen_;  // of `take_changed` without arguments
  ReplicaStatus status_;

  std::mutex life_mutex_;  // of the thread, which never takes it
  bool started_ = false;
  std::thread thread_;
};

}  // namespace burrlab
