// A server of connections, which one thread serves. What is sent on them, and said by them, is the services'.
#include "network/publisher.hpp"

#include <algorithm>
#include <chrono>

#include "copy_under.hpp"
#include "igtl_service.hpp"
#include "require.hpp"
#include "session/realtime.hpp"
#include "vrpn_service.hpp"

namespace burrlab {

constexpr std::int64_t stalled_after = 5 * second;  // [ns]
constexpr std::size_t largest_turn = 262144;        // sent to one peer at once [bytes]
constexpr std::size_t allowance = 65536;            // that a peer may send in a second [bytes]
constexpr std::uint64_t most_faults = 16;           // dropped messages before a connection is closed
constexpr double closing_time = 1.0;                // for what is left at the end [s]
constexpr std::uint64_t ticks_at_once = 64;         // for a peer that need not get all

static PublisherSettings checked(const PublisherSettings& settings) {
  require_positive("log", settings.log);
  if (settings.header_version != 1 && settings.header_version != 2)
    refuse("header_version", "1 or 2", settings.header_version);
  if (settings.hello.size() > replica_protocol::longest_text)
    refuse("length of hello", "at most 900000 bytes", double(settings.hello.size()));
  if (settings.most_peers < 1 || settings.most_peers > 256)
    refuse("most_peers", "1 to 256", double(settings.most_peers));
  if (settings.most_behind < 1024) refuse("most_behind", "at least 1024 bytes", double(settings.most_behind));
  if (settings.thin_after < 1 || settings.thin_after >= poses_kept)
    refuse("thin_after", "1 to 1023 ticks", double(settings.thin_after));
  if (settings.vrpn < -1 || settings.vrpn > 65535) refuse("vrpn", "0 to 65535", settings.vrpn);
  return settings;
}

std::vector<std::string> PublishedSession::burr_names() const {
  std::vector<std::string> names{"burrlab_burr_0", "burrlab_burr_1"};
  names.resize(burrs);
  return names;
}

std::uint64_t ticks_to_send(PublishedSession& session, const TickLog& log, std::uint64_t& tick) {
  tick = std::min(tick, log.next());
  if (log.next() - tick > session.settings.thin_after) {
    session.status.skipped += log.next() - 1 - tick;
    tick = log.next() - 1;
  }
  return std::min(log.next(), tick + ticks_at_once);
}

Publisher::Publisher(Follower& follower, const PublisherSettings& settings)
    : follower_(follower),
      server_(checked(settings).host, settings.port, standard_send_buffer),
      session_(std::make_unique<PublishedSession>()) {
  session_->settings = settings;
  follower.visit([this](FollowedBone& bone) {
    session_->burrs = std::uint32_t(bone.executor().burrs());
    session_->period = bone.executor().setup().period;
    session_->status.tick = bone.tick();
    replicas_ = std::make_unique<ReplicaService>(*session_, bone);
  });
  igtl_ = std::make_unique<IgtlService>(*session_, *replicas_);
  if (settings.vrpn >= 0) vrpn_ = std::make_unique<VrpnService>(*session_);
  thread_ = std::thread([this] { run(); });
}

Publisher::~Publisher() { stop(); }

int Publisher::vrpn_port() const { return vrpn_ ? vrpn_->server().port() : 0; }

const PublisherSettings& Publisher::settings() const { return session_->settings; }

std::uint64_t Publisher::session() const { return replicas_->session_number(); }

PublisherStatus Publisher::status() const { return copy_under(session_->mutex, session_->status); }

void Publisher::stop() {
  stopping_.store(true);
  server_.wake();
  const std::lock_guard<std::mutex> lock(life_mutex_);
  if (thread_.joinable()) thread_.join();
}

void Publisher::on_tick(const TickRecord& record) {
  const std::lock_guard<std::mutex> lock(session_->mutex);
  if (session_->ended) return;
  replicas_->append_tick(record);
  session_->newest = record;
  log_newest();
  session_->status.tick = record.index + 1;
}

/// A peer that gives the force to a hand must not hold the last one.
void Publisher::on_end() {
  const std::lock_guard<std::mutex> lock(session_->mutex);
  if (igtl_->empty()) return;
  for (BurrRecord& burr : session_->newest.burr) burr.force = {};
  log_newest();
}

void Publisher::log_newest() {
  const std::uint64_t timestamp = openigtlink::timestamp_now();
  igtl_->append_newest(timestamp);
  if (vrpn_) vrpn_->append_newest(timestamp);
}

void Publisher::on_digest(std::uint64_t tick, const Hash128& digest) {
  const std::lock_guard<std::mutex> lock(session_->mutex);
  if (!session_->ended) replicas_->append_digest(tick, digest);
}

void Publisher::on_rebuild(std::uint64_t tick) {
  const std::lock_guard<std::mutex> lock(session_->mutex);
  if (tick == replicas_->next_tick()) return;
  replicas_->restart(tick);
  igtl_->restart(tick);
  if (vrpn_) vrpn_->restart(tick);
  session_->status.tick = tick;
}

void Publisher::on_bone(FollowedBone& bone) {
  replicas_->take_awaited_state(bone);
  if (connected_.load(std::memory_order_relaxed) > 0 && !waking_.exchange(true)) server_.wake();
}

void Publisher::finish(const std::string& reason, bool failed, double linger) {
  require_not_negative("linger", linger);
  follower_.visit([&](FollowedBone& bone) { replicas_->end(bone, reason, failed); });
  server_.wake();
  wait_until(steady_after(linger), std::chrono::milliseconds(2), [this] {
    const std::lock_guard<std::mutex> lock(session_->mutex);
    return !replicas_->awaits_replicas();
  });
  stop();
}

void Publisher::run() {
  Peers peers;
  std::vector<TcpServer::Interest> interests;
  bool room = true;
  while (!stopping_.load()) {
    interests.clear();
    for (const auto& peer : peers) {  // the answers that a peer does not take must not pile up
      const bool may_ask = !peer->closing && peer->allowance > 0 && peer->pending.size() < largest_turn;
      interests.push_back({peer->socket, may_ask, !peer->idle()});
    }
    if (vrpn_)
      for (const int socket : {room ? vrpn_->server().socket() : -1, vrpn_->request_socket()})
        interests.push_back({socket, true, false});
    const bool connecting = server_.wait(interests, room, 20);
    waking_.store(false);
    const std::int64_t now = steady_now();
    for (std::size_t i = 0; i < peers.size(); ++i) {
      Peer& peer = *peers[i];
      if (now - peer.last_allowance > second) {
        peer.allowance = allowance;
        peer.last_allowance = now;
      }
      if (interests[i].readable || interests[i].writable) peer.connecting = false;
      if ((!interests[i].readable || read(peer)) && write(peer)) continue;
      const std::lock_guard<std::mutex> lock(session_->mutex);
      peer.leave();
      peers[i].reset();
    }
    peers.erase(std::remove(peers.begin(), peers.end(), nullptr), peers.end());
    room = !connecting || accept_all(peers, server_);
    if (vrpn_ && interests[interests.size() - 2].readable) room = accept_all(peers, vrpn_->server()) && room;
    if (vrpn_ && interests.back().readable) {
      const auto count =
          std::count_if(peers.begin(), peers.end(), [](const auto& p) { return p->connecting; });
      vrpn_->answer_requests(server_.port(), std::size_t(count),
                             [&](std::unique_ptr<Peer> peer) { return admit(peers, std::move(peer)); });
    }
    count_peers(peers);
  }
  server_.stop_listening();
  if (vrpn_) vrpn_->close();
  std::vector<Peer*> left;  // have not got all: the last force is 0, and a hand must not hold the one before
  for (const auto& peer : peers) left.push_back(peer.get());
  const auto is_done = [this](Peer* peer) { return !write(*peer) || peer->idle(); };
  for (const std::int64_t end = steady_after(closing_time); steady_now() < end;) {
    left.erase(std::remove_if(left.begin(), left.end(), is_done), left.end());
    if (left.empty()) break;
    interests.clear();
    for (const Peer* peer : left) interests.push_back({peer->socket, false, true});
    server_.wait(interests, false, 20);
  }
  {
    const std::lock_guard<std::mutex> lock(session_->mutex);
    peers.clear();
  }
  count_peers(peers);
}

bool Publisher::accept_all(Peers& peers, TcpServer& server) {
  for (int i = 0; i < 64; ++i) {
    int socket = -1;
    const TcpServer::Accepted accepted = server.accept(socket);
    if (accepted != TcpServer::Accepted::connection) return accepted == TcpServer::Accepted::none;
    admit(peers, &server == &server_ ? igtl_->make_peer(socket) : vrpn_->make_peer(socket));
  }
  return true;
}

bool Publisher::admit(Peers& peers, std::unique_ptr<Peer> peer) {
  const std::lock_guard<std::mutex> lock(session_->mutex);
  if (peers.size() >= session_->settings.most_peers) {
    ++session_->status.refused;
    return false;
  }
  ++session_->status.accepted;
  peers.push_back(std::move(peer));
  return true;
}

void Publisher::count_peers(const Peers& peers) {
  connected_.store(peers.size(), std::memory_order_relaxed);
  const std::lock_guard<std::mutex> lock(session_->mutex);
  replicas_->forget_lost_replicas();
  PublisherStatus& status = session_->status;
  status.replicas = replicas_->replicas();
  status.standard_peers = peers.size() - status.replicas;
  status.vrpn_peers = vrpn_ ? vrpn_->peers() : 0;
}

bool Publisher::read(Peer& peer) {
  std::uint8_t bytes[16384];
  const long size = TcpServer::receive(peer.socket, bytes, std::min(sizeof bytes, peer.allowance));
  if (size < 0) return false;
  if (size == 0) return true;
  peer.allowance -= std::size_t(size);
  const openigtlink::Counters before = peer.cutter().counters();
  const std::lock_guard<std::mutex> lock(session_->mutex);
  PublisherStatus& status = session_->status;
  const bool whole = peer.feed({bytes, std::size_t(size)});
  const openigtlink::Counters& counters = peer.cutter().counters();
  status.received.messages += counters.messages - before.messages;
  for (std::size_t i = 0; i < counters.dropped.size(); ++i)
    status.received.dropped[i] += counters.dropped[i] - before.dropped[i];
  if (!whole) ++status.framing_lost;
  const bool faulty = whole && counters.all_dropped() >= most_faults;
  if (faulty) ++status.too_many_faults;
  return whole && !faulty;
}

bool Publisher::write(Peer& peer) {
  const std::int64_t now = steady_now();
  std::size_t done = 0;
  while (done < largest_turn && !peer.connecting) {
    if (peer.idle()) {
      if (peer.closing) return false;
      peer.pending.clear();
      peer.sent = 0;
      {
        const std::lock_guard<std::mutex> lock(session_->mutex);
        if (!peer.too_slow()) peer.refill();
      }
      if (peer.pending.empty()) {
        if (peer.greeted()) peer.last_progress = now;
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
  const std::lock_guard<std::mutex> lock(session_->mutex);
  session_->status.bytes_sent += done;
  const bool stalled = now - peer.last_progress > stalled_after;
  const bool too_slow = !stalled && peer.too_slow();  // also while bytes are on their way
  session_->status.stalled += stalled;
  session_->status.cut_off += too_slow;
  return !stalled && !too_slow;
}

}  // namespace burrlab
