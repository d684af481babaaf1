// The other machine: a bone that follows a leader's ticks over the network and is the same to the bit.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "burrlab/copy_under.hpp"
#include "burrlab/network/message_framer.hpp"
#include "burrlab/network/replica_protocol.hpp"
#include "burrlab/network/tcp_client.hpp"
#include "burrlab/session/follower.hpp"

namespace burrlab {

/// Why a connection was given up.
struct ReplicaFault {
  std::uint64_t tick = 0;  ///< ticks executed: the next was expected
  std::uint64_t seen = 0;  ///< tick of the message that told; `tick` where none did
  std::string reason;
};

/// The bone was not the leader's.
struct Divergence {
  std::uint64_t tick = 0;             ///< ticks executed when it was found
  std::string what;                   ///< "digest", or a result of a burr: "force of burr 0"
  std::uint64_t compared_at = 0;      ///< ticks executed when the bricks were held against the leader's
  bool exact = false;                 ///< the leader's bricks were of the same tick; else ticks lie between
  std::vector<std::uint32_t> bricks;  ///< that differed, repaired by now
};

struct ReplicaStatus {
  std::uint64_t tick = 0;         ///< ticks executed
  std::uint64_t connections = 0;  ///< made, the hello received
  std::uint64_t by_ticks = 0;     ///< connections after the first that went on by ticks
  std::uint64_t by_bricks = 0;    ///< times that the bone was put to the leader's
  std::uint64_t digests_equal = 0, digests_different = 0;
  std::uint64_t differing_ticks = 0;  ///< whose force, penetration or removed volume was another
  std::uint64_t faults = 0;           ///< connections given up
  std::uint64_t most_missed = 0;      ///< ticks between a loss and the message that told, at most
  bool connected = false;
  bool ended = false, failed = false;
  std::string reason;                     ///< why it ended
  std::vector<ReplicaFault> last_faults;  ///< at most 1000
  std::vector<Divergence> divergences;    ///< at most 1000
  openigtlink::Counters received;
};

class Replica {
 public:
  /// std::invalid_argument where `host` has no address or `port` is not 1 to 65535.
  Replica(const std::string& host, int port);
  ~Replica() { stop(); }
  Replica(const Replica&) = delete;
  Replica& operator=(const Replica&) = delete;

  /// Asks the leader for its hello, for `timeout` [s]; false where none came.
  bool fetch_hello(double timeout);
  const replica_protocol::Hello& hello() const { return hello_; }

  /// Follows from now on, in a thread of its own. `bone` is changed in place, and the replica's until the
  /// session ends. Throws unless the hello is there, the bone has its digest and no one else uses it.
  void start(std::shared_ptr<VoxelBone> bone, const SessionSetup& setup,
             std::shared_ptr<AnatomyWatch> watch = nullptr);
  void stop(const std::string& reason = "stopped");
  bool wait(double seconds);  ///< until the session ends; whether it has

  ReplicaStatus status() const { return copy_under(mutex_, status_); }
  TickRecord newest() const { return copy_under(mutex_, newest_); }  ///< record of the last tick executed
  std::string digest() const;
  std::shared_ptr<VoxelBone> snapshot(std::uint64_t& tick) const;
  /// What changed since the last call; the first gives all that is not as in the initial volume.
  BoneUpdate take_changed();
  /// For a consumer of its own: what changed since it last asked, from now on. Throws before `start`.
  std::shared_ptr<UnseenBricks> unseen();
  BoneUpdate take_changed(UnseenBricks& unseen);
  /// Calls with the bone between two ticks; none is executed meanwhile.
  void visit(const std::function<void(FollowedBone&)>& function);
  const VoxelBone& bone() const;  ///< for what never changes of it, as its shape
  /// Changes one voxel (z, y, x), so that tests see it found and repaired.
  void flip(const Index3& voxel);

 private:
  enum class Stage { hello, following };

  void run();
  bool follow();
  bool say_word(replica_protocol::Holds holds);
  void mark_changed();
  BoneUpdate update_of(UnseenBricks& unseen);
  void take(const openigtlink::Message& message);
  void take_hello(const replica_protocol::Hello& hello);
  void take_tick(const replica_protocol::TickMessage& tick);
  void take_digest(const replica_protocol::Digest& digest);
  void take_bricks(const replica_protocol::Bricks& bricks);
  void take_end(const replica_protocol::End& end);
  void put_bricks();
  void diverge(const std::string& what);
  void fault(const std::string& reason, std::uint64_t seen);
  void fault(const std::string& reason) { fault(reason, bone_->tick()); }
  void end(const std::string& reason, bool failed);
  FollowedBone& followed() const;  // throws before `start`

  TcpClient client_;
  replica_protocol::Hello hello_;
  openigtlink::MessageFramer framer_;
  Stage stage_ = Stage::hello;
  bool broken_ = false;    // this connection is given up
  bool progress_ = false;  // it was of use, or showed a bone to be repaired: the next follows at once
  bool first_ = true;      // nothing followed on its hello yet
  bool any_digest_ = false;
  std::uint64_t digest_tick_ = 0;       // of the digest that came last
  std::vector<std::uint32_t> numbers_;  // bricks on their way in
  std::vector<std::uint8_t> levels_;
  replica_protocol::Bricks incoming_;
  int repairs_ = 0;  // in a row that did not help

  mutable std::mutex mutex_;  // of all below
  std::unique_ptr<VoxelBone> initial_;
  std::unique_ptr<FollowedBone> bone_;
  std::unique_ptr<VoxelBone::Changing> changing_;  // until the session has ended
  bool suspect_ = false;
  Divergence divergence_;  // found, bricks not known yet
  TickRecord newest_;
  bool any_ = false;
  std::shared_ptr<UnseenBricks> unseen_;  // of `take_changed` without an argument
  std::vector<std::weak_ptr<UnseenBricks>> consumers_;
  ReplicaStatus status_;

  std::mutex life_mutex_;  // of the thread; the thread itself never takes it
  bool started_ = false;
  std::thread thread_;
};

}  // namespace burrlab
