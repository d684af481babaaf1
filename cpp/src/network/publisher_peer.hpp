// One connection of a publisher, and a state of the bone that may be on its way to it.
#pragma once

#include "burrlab/network/publisher.hpp"
#include "burrlab/session/realtime.hpp"

namespace burrlab {

/// The bricks that were not as in the initial volume after `tick` ticks.
struct Publisher::State {
  std::uint64_t tick = 0;
  std::string digest;
  std::vector<std::uint32_t> bricks;
  std::vector<std::uint8_t> levels;  // q and p of each
};

struct Publisher::Peer {
  explicit Peer(int connection) : socket(connection) {}
  ~Peer() { TcpServer::close(socket); }
  Peer(const Peer&) = delete;
  Peer& operator=(const Peer&) = delete;

  int socket;
  openigtlink::MessageFramer framer{4096};
  openigtlink::Bytes pending;  // bytes on their way, `sent` of them are gone
  std::size_t sent = 0;
  bool closing = false;  // when they are gone

  bool replica = false, caught_up = false;
  std::uint64_t tick = 0;   // a standard peer's next
  std::uint64_t place = 0;  // a replica's, in the log
  bool wants_state = false;
  bool suspect = false;  // wants the state besides its missing ticks
  std::uint64_t holds = 0;
  std::shared_ptr<const State> state;  // to be sent at `state_place`
  std::uint64_t state_place = 0;
  std::size_t next_brick = 0;
  bool told_end = false, left = false;

  std::int64_t last_progress = steady_now(), last_queued = steady_now(),
               last_allowance = steady_now();  // [ns]
  std::size_t allowance = 65536;               // bytes that it may still send in this second

  bool idle() const { return sent == pending.size(); }
};

}  // namespace burrlab
