// The network's side of a publisher: one thread, which waits for all its peers at once.
#include <algorithm>

#include "publisher_peer.hpp"

namespace burrlab {

using openigtlink::Message;
using replica_protocol::Holds;
using replica_protocol::Word;

namespace {

constexpr std::size_t chunk = 65536;         // bytes taken from a log at once
constexpr std::size_t a_turn = 4 * chunk;    // sent to one peer before it is another's turn [bytes]
constexpr std::uint64_t ticks_at_once = 64;  // taken for a standard peer
constexpr std::uint64_t most_faults = 16;    // dropped messages until a connection is closed
constexpr int replica_send_buffer = 65536;   // of the system [bytes]
constexpr std::int64_t second = 1000000000;
constexpr std::int64_t idle_every = second / 5, stalled_after = 5 * second;
constexpr std::int64_t grace = 3 * second;  // for a replica to come, after its hello, or to come back

}  // namespace

void Publisher::run() {
  Peers peers;
  std::vector<TcpServer::Interest> interests;
  bool room = true;
  while (!stopping_.load()) {
    interests.clear();
    for (const auto& peer : peers)
      interests.push_back({peer->socket, !peer->closing && peer->allowance > 0, !peer->idle()});
    const bool knocking = server_.wait(interests, room, 20);
    waking_.store(false);
    const std::int64_t now = steady_now();
    for (std::size_t i = 0; i < peers.size(); ++i) {
      Peer& peer = *peers[i];
      if (now - peer.last_allowance > second) {
        peer.allowance = chunk;
        peer.last_allowance = now;
      }
      const bool alive = (!interests[i].readable || read(peer)) && write(peer);
      if (!alive) leave(peers[i], now);
    }
    peers.erase(std::remove(peers.begin(), peers.end(), nullptr), peers.end());
    room = knocking ? accept_all(peers) : true;
    count_peers(peers);
  }
  server_.stop_listening();
  peers.clear();
  count_peers(peers);
}

/// A replica that did not say that it leaves comes back, told the end or not: it may have missed it.
void Publisher::leave(std::unique_ptr<Peer>& peer, std::int64_t now) {
  if (peer->replica && !peer->left) {
    const std::lock_guard<std::mutex> lock(mutex_);
    missing_.push_back(now + grace);
  }
  peer.reset();
}

bool Publisher::accept_all(Peers& peers) {
  for (int i = 0; i < 64; ++i) {
    int socket = -1;
    const TcpServer::Accepted accepted = server_.accept(socket);
    if (accepted != TcpServer::Accepted::connection) return accepted == TcpServer::Accepted::none;
    auto peer = std::make_unique<Peer>(socket);
    const std::lock_guard<std::mutex> lock(mutex_);
    if (peers.size() >= settings_.most_peers) {
      ++status_.refused;
      continue;
    }
    ++status_.accepted;
    peer->tick = poses_.next();
    peers.push_back(std::move(peer));
  }
  return true;
}

void Publisher::count_peers(const Peers& peers) {
  connected_.store(peers.size(), std::memory_order_relaxed);
  const std::lock_guard<std::mutex> lock(mutex_);
  status_.replicas = std::uint64_t(
      std::count_if(peers.begin(), peers.end(), [](const auto& peer) { return peer->replica; }));
  status_.standard_peers = peers.size() - status_.replicas;
  const std::int64_t now = steady_now();
  missing_.erase(std::remove_if(missing_.begin(), missing_.end(), [now](auto until) { return until < now; }),
                 missing_.end());
  const bool awaited =
      std::any_of(peers.begin(), peers.end(), [](const auto& peer) { return peer->wants_state; });
  wants_state_ = wants_state_ && awaited;
  if (!awaited && !ended_) state_.reset();
}

bool Publisher::read(Peer& peer) {
  std::uint8_t bytes[16384];
  const long got = TcpServer::receive(peer.socket, bytes, std::min(sizeof bytes, peer.allowance));
  if (got < 0) return false;
  if (got == 0) return true;
  peer.allowance -= std::size_t(got);
  const openigtlink::Counters before = peer.framer.counters();
  const bool whole =
      peer.framer.feed({bytes, std::size_t(got)}, [&](const Message& message) { hear(peer, message); });
  const openigtlink::Counters& now = peer.framer.counters();
  const std::lock_guard<std::mutex> lock(mutex_);
  status_.received.messages += now.messages - before.messages;
  for (std::size_t i = 0; i < now.dropped.size(); ++i)
    status_.received.dropped[i] += now.dropped[i] - before.dropped[i];
  if (!whole) ++status_.framing_lost;
  const bool faulty = whole && now.all_dropped() >= most_faults;
  if (faulty) ++status_.too_many_faults;
  return whole && !faulty;
}

void Publisher::hear(Peer& peer, const Message& message) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Word word;
  if (peer.closing || replica_protocol::kind_of(message) != replica_protocol::Kind::word) {
    ++status_.ignored;
  } else if (peer.replica) {
    if (decode(message, word) && word.holds == Holds::all)
      peer.left = true;
    else
      ++status_.ignored;
  } else if (decode(message, word)) {
    serve(peer, word);
  } else {
    ++status_.bad_words;
    peer.closing = true;
  }
}

void Publisher::serve(Peer& peer, const Word& word) {
  encode(peer.pending, settings_.header_version, hello_);
  if (word.holds == Holds::nothing || word.holds == Holds::all || word.session != session_ ||
      word.digest != hello_.digest) {
    ++status_.hellos;
    peer.closing = true;
    if (word.holds == Holds::nothing) missing_.push_back(steady_now() + grace);
    return;
  }
  peer.replica = true;
  ++status_.replicas;  // before it is no longer missing: `finish` waits for either
  TcpServer::set_send_buffer(peer.socket, replica_send_buffer);
  if (!missing_.empty()) missing_.erase(missing_.begin());
  peer.holds = word.tick;
  const bool in_log = log_.place_of(word.tick, peer.place);
  if (in_log && word.holds == Holds::ticks) {
    ++status_.by_ticks;
    return;
  }
  peer.suspect = in_log;
  peer.wants_state = true;
  if (!ended_) wants_state_ = true;
}

/// Whether the state that was waited for is there, and goes to this peer.
bool Publisher::give_state(Peer& peer) {
  if (wants_state_ || !state_) return false;
  std::uint64_t at = 0;
  if (!log_.place_of(state_->tick, at) || (peer.suspect && state_->tick < peer.holds)) {
    wants_state_ = !ended_;  // an old one, or the log began anew
    return false;
  }
  // A suspect bone is brought to the tick of the state first, so that they can be held against one another.
  if (!peer.suspect || !log_.place_of(peer.holds, peer.place)) peer.place = at;
  peer.state = state_;
  peer.state_place = at;
  peer.wants_state = false;
  ++status_.by_bricks;
  return true;
}

bool Publisher::write(Peer& peer) {
  const std::int64_t now = steady_now();
  std::size_t done = 0;
  while (done < a_turn) {
    if (peer.idle()) {
      if (peer.closing) return false;
      peer.pending.clear();
      peer.sent = 0;
      if (!refill(peer)) return false;
      if (peer.pending.empty()) {
        peer.last_progress = now;
        break;
      }
      peer.last_queued = now;
    }
    const long sent =
        TcpServer::send(peer.socket, peer.pending.data() + peer.sent, peer.pending.size() - peer.sent);
    if (sent < 0) return false;
    if (sent == 0) break;
    peer.sent += std::size_t(sent);
    done += std::size_t(sent);
    peer.last_progress = now;
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  status_.bytes_sent += done;
  if (now - peer.last_progress > stalled_after) {
    ++status_.stalled;
    return false;
  }
  // While bytes are on their way a peer falls behind as well.
  if (!peer.replica || !peer.caught_up || log_.end() - peer.place <= settings_.most_behind) return true;
  ++status_.cut_off;
  return false;
}

bool Publisher::refill(Peer& peer) {
  const std::lock_guard<std::mutex> lock(mutex_);
  return peer.replica ? refill_replica(peer) : refill_standard(peer);
}

bool Publisher::refill_standard(Peer& peer) {
  if (peer.tick > poses_.next()) peer.tick = poses_.next();
  if (poses_.next() - peer.tick > settings_.thin_after) {
    status_.skipped += poses_.next() - 1 - peer.tick;
    peer.tick = poses_.next() - 1;
  }
  const std::uint64_t until = std::min(poses_.next(), peer.tick + ticks_at_once);
  std::uint64_t from = 0, to = 0;
  if (poses_.place_of(peer.tick, from) && poses_.place_of(until, to))
    poses_.copy(from, std::size_t(to - from), peer.pending);
  peer.tick = until;
  return true;
}

bool Publisher::refill_replica(Peer& peer) {
  if (peer.wants_state && !give_state(peer)) {
    say_idle(peer);
    return true;
  }
  if (peer.place < log_.begin()) {  // too slow for the log, or the follower was rebuilt
    ++status_.cut_off;
    return false;
  }
  if (log_.end() - peer.place <= settings_.most_behind / 2 && !peer.state) peer.caught_up = true;
  if (peer.state && peer.place == peer.state_place) {
    const State& state = *peer.state;
    replica_protocol::Bricks bricks{
        state.tick, state.digest, std::uint32_t(state.bricks.size()), std::uint32_t(peer.next_brick), {}};
    const std::size_t until =
        std::min(peer.next_brick + replica_protocol::bricks_a_message, state.bricks.size());
    openigtlink::Bytes content;
    for (std::size_t i = peer.next_brick; i < until; ++i) {
      for (int shift = 24; shift >= 0; shift -= 8) content.push_back(std::uint8_t(state.bricks[i] >> shift));
      const auto levels = state.levels.begin() + std::ptrdiff_t(i * 2 * brick_voxels);
      content.insert(content.end(), levels, levels + 2 * brick_voxels);
    }
    bricks.bricks = {content.data(), content.size()};
    encode(peer.pending, settings_.header_version, bricks);
    peer.next_brick = until;
    if (until == state.bricks.size()) peer.state.reset();
    return true;
  }
  const std::uint64_t until = peer.state ? peer.state_place : log_.end();
  peer.place +=
      log_.copy(peer.place, std::size_t(std::min<std::uint64_t>(until - peer.place, chunk)), peer.pending);
  if (peer.pending.empty()) say_idle(peer);
  return true;
}

/// So that silence means a broken connection; after the end it is said again and again until all have it.
void Publisher::say_idle(Peer& peer) {
  const bool first_end = ended_ && !peer.wants_state && !peer.told_end;
  if (!first_end && steady_now() - peer.last_queued < idle_every) return;
  if (ended_ && !peer.wants_state) {
    encode(peer.pending, settings_.header_version, end_);
    peer.told_end = true;
  } else {
    const std::uint64_t tick = peer.wants_state ? peer.holds : log_.next();  // what the replica has by then
    encode(peer.pending, settings_.header_version, replica_protocol::Idle{tick});
  }
}

}  // namespace burrlab
