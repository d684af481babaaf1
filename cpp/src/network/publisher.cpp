// The follower's side of a publisher makes bytes of each tick once, for all peers. The network's side is one
// thread that waits for all peers at once.
#include "burrlab/network/publisher.hpp"

#include <algorithm>
#include <chrono>
#include <random>
#include <sstream>

#include "burrlab/check.hpp"
#include "burrlab/network/bone_frame.hpp"
#include "burrlab/session/realtime.hpp"
#include "wire.hpp"

namespace burrlab {

using openigtlink::Bytes;
using openigtlink::ByteView;
using openigtlink::Message;
using replica_protocol::Holds;
using replica_protocol::Word;

namespace {

constexpr std::size_t largest_head = 130, largest_burr = 128;  // of a tick's message, either version [bytes]
constexpr std::size_t largest_pose = 380, poses_kept = 1024;   // of one burr; ticks
constexpr int send_buffer = 8192;  // of standard peers: small, so that a slow one gets no old poses [bytes]
constexpr std::size_t most_states = 4;           // of the bone in memory at once
constexpr std::int64_t state_pause = 100000000;  // between two of them [ns]

PublisherSettings checked(const PublisherSettings& settings) {
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

std::size_t ticks_of_log(double seconds, double period) {
  const double ticks = std::ceil(seconds * 1e3 / period);
  if (!(ticks <= 2e6)) refuse("ticks of the log", "at most 2000000", ticks);
  return std::size_t(ticks);
}

/// Of the forces as PLUS and 3D Slicer read them.
constexpr std::string_view force_name[] = {"Force", "Force_1"};

const std::vector<std::string>& names_of(std::uint32_t burrs) {
  static const std::vector<std::string> one{"burrlab_burr_0"}, two{"burrlab_burr_0", "burrlab_burr_1"};
  return burrs == 1 ? one : two;
}

Vec3 force_in_ras(const BurrRecord& burr) {
  return {0.0 - burr.force[0], 0.0 - burr.force[1], burr.force[2]};
}

std::uint64_t random_number() {
  std::random_device device;
  for (;;)
    if (const std::uint64_t number = (std::uint64_t(device()) << 32) | device()) return number;
}

constexpr std::size_t chunk = 65536;         // bytes taken from a log at once
constexpr std::size_t a_turn = 4 * chunk;    // bytes sent to one peer in its turn
constexpr std::uint64_t ticks_at_once = 64;  // taken for a standard peer
constexpr std::uint64_t most_faults = 16;    // dropped messages before a connection is closed
constexpr int replica_send_buffer = 65536;   // of the system [bytes]
constexpr std::int64_t second = 1000000000;
constexpr std::int64_t idle_every = second / 5, stalled_after = 5 * second;
constexpr std::size_t most_calls = 16;  // requests by UDP read in a second, and calls back not yet taken
constexpr std::size_t udp_size = vrpn::pose_size + vrpn::velocity_size;  // of a burr and tick [bytes]
constexpr std::int64_t grace = 3 * second;  // for a replica to come after its hello, or to come back

}  // namespace

/// The bricks that differ from the initial volume after `tick` ticks.
struct Publisher::State {
  std::uint64_t tick = 0;
  std::string digest;
  std::vector<std::uint32_t> bricks;
  std::vector<std::uint8_t> levels;  // q and p of each
};

/// One connection.
struct Publisher::Peer {
  explicit Peer(int connection) : socket(connection) {}
  ~Peer() { TcpServer::close(socket); }
  Peer(const Peer&) = delete;
  Peer& operator=(const Peer&) = delete;

  int socket;
  openigtlink::MessageFramer framer{4096};
  std::unique_ptr<vrpn::Reader> vrpn;  // of a VRPN client
  openigtlink::StreamCutter& cutter() {
    return vrpn ? static_cast<openigtlink::StreamCutter&>(*vrpn) : framer;
  }
  bool connecting = false;     // called back, and not yet there
  PeerAddress address, poses;  // of a VRPN client, and where it awaits UDP packets
  std::uint32_t next_on_tcp = 0, next_on_udp = 0;
  openigtlink::Bytes pending;  // bytes to send, the first `sent` of them sent
  std::size_t sent = 0;
  bool closing = false;  // once they are sent

  bool replica = false, caught_up = false;
  std::uint64_t tick = 0;   // a standard peer's next
  std::uint64_t place = 0;  // a replica's, in the log
  bool wants_state = false;
  bool suspect = false;  // wants the state as well as its missing ticks
  std::uint64_t holds = 0;
  std::shared_ptr<const State> state;  // to be sent at `state_place`
  std::uint64_t state_place = 0;
  std::size_t next_brick = 0;
  bool told_end = false, left = false;

  std::int64_t last_progress = steady_now(), last_queued = steady_now(),
               last_allowance = steady_now();  // [ns]
  std::size_t allowance = 65536;               // bytes the peer may still send in this second

  bool idle() const { return sent == pending.size(); }
};

Publisher::Publisher(Follower& follower, const PublisherSettings& settings)
    : settings_(checked(settings)),
      session_(random_number()),
      server_(settings.host, settings.port, send_buffer) {
  if (settings.vrpn >= 0) vrpn_.reset(new VrpnPort{{settings.host, settings.vrpn, send_buffer}});
  follower.visit([this](FollowedBone& bone) {
    burrs_ = std::uint32_t(bone.executor().burrs());
    period_ = bone.executor().setup().period;
    status_.tick = digest_tick_ = bone.tick();
    hello_ = {replica_protocol::version, session_, bone.tick(), bone.initial_digest().text(),
              settings_.hello};
  });
  const std::size_t ticks = ticks_of_log(settings.log, period_);
  log_ = TickLog(ticks * (largest_head + largest_burr * burrs_) + 65536, ticks, digest_tick_);
  poses_ = TickLog(poses_kept * largest_pose * burrs_, poses_kept, digest_tick_);
  vrpn_log_ = TickLog(poses_kept * (udp_size + vrpn::force_size) * burrs_, poses_kept, digest_tick_);
  thread_ = std::thread([this] { run(); });
}

void Publisher::stop() {
  stopping_.store(true);
  server_.wake();
  const std::lock_guard<std::mutex> lock(life_mutex_);
  if (thread_.joinable()) thread_.join();
}

void Publisher::on_tick(const TickRecord& record) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (ended_) return;
  scratch_.clear();
  encode(scratch_, settings_.header_version, replica_protocol::TickMessage{record, digest_tick_});
  log_.append_tick({scratch_.data(), scratch_.size()});
  newest_ = record;
  tell_standard();
  status_.tick = record.index + 1;
}

/// A peer that gives the force to a hand must not hold the last one.
void Publisher::on_end() {
  const std::lock_guard<std::mutex> lock(mutex_);
  for (BurrRecord& burr : newest_.burr) burr.force = {};
  if (poses_.end() > 0) tell_standard();
}

/// Tells standard peers and VRPN clients the newest tick.
void Publisher::tell_standard() {
  scratch_.clear();
  static constexpr std::string_view sensor_name[] = {"burrlab_force_0", "burrlab_force_1"};
  openigtlink::Envelope envelope;
  envelope.timestamp = openigtlink::timestamp_now();
  envelope.version = settings_.header_version;
  for (std::uint32_t i = 0; i < burrs_; ++i) {
    const BurrRecord& burr = newest_.burr[i];
    const Vec3 center(burr.center.data());
    if (openigtlink::is_plausible(center)) {
      envelope.device_name = names_of(burrs_)[i];
      encode_transform(scratch_, envelope, openigtlink::to_ras(center, burr.orientation));
    } else {
      ++status_.out_of_range;
    }
    if (settings_.sensor) {
      envelope.device_name = sensor_name[i];
      encode_sensor(scratch_, envelope, force_in_ras(burr).data(), 3);
    }
    envelope.device_name = force_name[i];
    encode_transform(scratch_, envelope, openigtlink::to_ras(Vec3(burr.force.data())));
  }
  poses_.append_tick({scratch_.data(), scratch_.size()});
  if (vrpn_) encode_vrpn(newest_, envelope.timestamp);
}

/// Poses and velocities first: they may go over UDP. The velocity is the device's; it turned since the last
/// tick.
void Publisher::encode_vrpn(const TickRecord& record, std::uint64_t timestamp) {
  scratch_.clear();
  for (std::uint32_t i = 0; i < burrs_; ++i) {
    const BurrRecord& burr = record.burr[i];
    const Vec3 center(burr.center.data()), velocity(burr.device_velocity.data());
    const Eigen::Quaterniond now = to_eigen(burr.orientation);
    const Eigen::Quaterniond turn = last_turn_[i] == Quaternion{} ? Eigen::Quaterniond::Identity()
                                                                  : now * to_eigen(last_turn_[i]).conjugate();
    last_turn_[i] = burr.orientation;
    vrpn::encode_pose(scratch_, std::int32_t(i), timestamp, 1e-3 * center, burr.orientation);
    vrpn::encode_velocity(scratch_, std::int32_t(i), timestamp, 1e-3 * velocity,
                          {turn.w(), turn.x(), turn.y(), turn.z()}, 1e-3 * period_ * record.k);
  }
  for (std::uint32_t i = 0; i < burrs_; ++i)
    vrpn::encode_force(scratch_, std::int32_t(i), timestamp, Vec3(record.burr[i].force.data()));
  vrpn_log_.append_tick({scratch_.data(), scratch_.size()});
}

void Publisher::on_digest(std::uint64_t tick, const Hash128& digest) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (ended_) return;
  scratch_.clear();
  encode(scratch_, settings_.header_version, replica_protocol::Digest{tick, digest.text()});
  log_.append({scratch_.data(), scratch_.size()});
  digest_tick_ = tick;
}

void Publisher::on_rebuild(std::uint64_t tick) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (tick == log_.next()) return;
  log_.restart(tick);
  poses_.restart(tick);
  vrpn_log_.restart(tick);
  last_turn_ = {};
  status_.tick = tick;
}

void Publisher::on_bone(FollowedBone& bone) {
  bool wanted;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    wanted = wants_state_ && !ended_ && may_take_state();
  }
  if (wanted) {
    std::shared_ptr<const State> state = take_state(bone);
    const std::lock_guard<std::mutex> lock(mutex_);
    states_.push_back(state);
    last_state_ = steady_now();
    state_ = std::move(state);
    wants_state_ = false;
  }
  if (connected_.load(std::memory_order_relaxed) > 0 && !waking_.exchange(true)) server_.wake();
}

/// Limits the follower's work for replicas that keep asking, and the memory for slow ones.
bool Publisher::may_take_state() {
  states_.erase(std::remove_if(states_.begin(), states_.end(), [](const auto& s) { return s.expired(); }),
                states_.end());
  return states_.size() < most_states && steady_now() - last_state_ > state_pause;
}

std::shared_ptr<const Publisher::State> Publisher::take_state(FollowedBone& bone) {
  auto state = std::make_shared<State>();
  state->tick = bone.tick();
  state->digest = bone.digest().text();
  state->bricks = bone.differing();
  state->levels.resize(state->bricks.size() * 2 * brick_voxels);
  std::uint8_t* at = state->levels.data();
  for (const std::uint32_t brick : state->bricks) {
    bone.bone().read_brick(brick, at, at + brick_voxels);
    at += 2 * brick_voxels;
  }
  return state;
}

void Publisher::finish(Follower& follower, const std::string& reason, bool failed, double linger) {
  require_not_negative("linger", linger);
  std::shared_ptr<const State> state;
  follower.visit([&](FollowedBone& bone) { state = take_state(bone); });
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    end_ = {state->tick, state->digest, failed ? 1u : 0u, reason.substr(0, 10000)};
    state_ = std::move(state);
    wants_state_ = false;
    ended_ = true;
  }
  server_.wake();
  const std::int64_t until = steady_after(linger);
  const auto awaited = [this] {
    const std::lock_guard<std::mutex> lock(mutex_);
    return status_.replicas > 0 || !missing_.empty();
  };
  while (steady_now() < until && awaited()) std::this_thread::sleep_for(std::chrono::milliseconds(2));
  stop();
}

void Publisher::run() {
  Peers peers;
  std::vector<TcpServer::Interest> interests;
  bool room = true;
  while (!stopping_.load()) {
    if (steady_now() - last_calls_ > second) {
      last_calls_ = steady_now();
      calls_ = 0;
    }
    interests.clear();
    for (const auto& peer : peers) {  // the answers that a peer does not take must not pile up
      const bool may_ask = !peer->closing && peer->allowance > 0 && peer->pending.size() < a_turn;
      interests.push_back({peer->socket, may_ask, !peer->idle()});
    }
    if (vrpn_)
      for (const int socket :
           {room ? vrpn_->server.socket() : -1, calls_ < most_calls ? vrpn_->datagrams.socket() : -1})
        interests.push_back({socket, true, false});
    const bool knocking = server_.wait(interests, room, 20);
    waking_.store(false);
    const std::int64_t now = steady_now();
    for (std::size_t i = 0; i < peers.size(); ++i) {
      Peer& peer = *peers[i];
      if (now - peer.last_allowance > second) {
        peer.allowance = chunk;
        peer.last_allowance = now;
      }
      if (interests[i].readable || interests[i].writable) peer.connecting = false;
      const bool alive = (!interests[i].readable || read(peer)) && write(peer);
      if (!alive) leave(peers[i], now);
    }
    peers.erase(std::remove(peers.begin(), peers.end(), nullptr), peers.end());
    room = !knocking || accept_all(peers, server_);
    if (vrpn_ && interests[interests.size() - 2].readable) room = accept_all(peers, vrpn_->server) && room;
    if (vrpn_ && interests.back().readable) call_back(peers);
    count_peers(peers);
  }
  server_.stop_listening();
  if (vrpn_) vrpn_->close();                    // it stays: the follower's thread asks whether there is one
  for (const auto& peer : peers) write(*peer);  // what is left, as far as the system takes it at once
  peers.clear();
  count_peers(peers);
}

/// A replica that left without saying so will come back, even if told the end: it may have missed it.
void Publisher::leave(std::unique_ptr<Peer>& peer, std::int64_t now) {
  if (peer->replica && !peer->left) {
    const std::lock_guard<std::mutex> lock(mutex_);
    missing_.push_back(now + grace);
  }
  peer.reset();
}

bool Publisher::accept_all(Peers& peers, TcpServer& server) {
  for (int i = 0; i < 64; ++i) {
    int socket = -1;
    const TcpServer::Accepted accepted = server.accept(socket);
    if (accepted != TcpServer::Accepted::connection) return accepted == TcpServer::Accepted::none;
    auto peer = std::make_unique<Peer>(socket);
    if (&server != &server_) {
      peer->vrpn = std::make_unique<vrpn::Reader>(names_of(burrs_), 4096);
      peer->address = TcpServer::peer_of(socket);
    }
    admit(peers, std::move(peer));
  }
  return true;
}

bool Publisher::admit(Peers& peers, std::unique_ptr<Peer> peer) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (peers.size() >= settings_.most_peers) {
    ++status_.refused;
    return false;
  }
  ++status_.accepted;
  if (peer->vrpn) vrpn::encode_cookie(peer->pending);
  peer->tick = poses_.next();
  peers.push_back(std::move(peer));
  return true;
}

/// A client asks with "host port". Only the port is used: whoever asks is called at the address that asks, as
/// another one may not want it, but never at a port of ours: the server would be its own client.
void Publisher::call_back(Peers& peers) {
  char text[200];
  PeerAddress from;
  while (calls_ < most_calls) {
    const long size = vrpn_->datagrams.receive(reinterpret_cast<std::uint8_t*>(text), sizeof text - 1, from);
    if (size < 0) return;
    ++calls_;
    text[size] = 0;
    const char* space = std::strchr(text, ' ');
    const int port = space ? std::atoi(space + 1) : 0;
    const bool ours = port == server_.port() || port == vrpn_->server.port();
    const bool fits = port >= 1024 && port <= 65535 && !(ours && TcpServer::is_own(from));
    const bool room = std::count_if(peers.begin(), peers.end(), [](const auto& p) { return p->connecting; }) <
                      std::ptrdiff_t(most_calls);
    const int socket = fits && room ? TcpServer::connect(from.with_port(port), send_buffer) : -1;
    if (socket < 0) {
      const std::lock_guard<std::mutex> lock(mutex_);
      ++status_.refused;
      continue;
    }
    auto peer = std::make_unique<Peer>(socket);
    peer->vrpn = std::make_unique<vrpn::Reader>(names_of(burrs_), 4096);
    peer->address = from;
    peer->connecting = true;
    if (admit(peers, std::move(peer))) {
      const std::lock_guard<std::mutex> lock(mutex_);
      ++status_.vrpn_calls;
    }
  }
}

void Publisher::count_peers(const Peers& peers) {
  connected_.store(peers.size(), std::memory_order_relaxed);
  const std::lock_guard<std::mutex> lock(mutex_);
  status_.replicas = std::uint64_t(
      std::count_if(peers.begin(), peers.end(), [](const auto& peer) { return peer->replica; }));
  status_.standard_peers = peers.size() - status_.replicas;
  status_.vrpn_peers = std::uint64_t(
      std::count_if(peers.begin(), peers.end(), [](const auto& p) { return p->vrpn && p->vrpn->greeted(); }));
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
  const openigtlink::Counters before = peer.cutter().counters();
  const ByteView view{bytes, std::size_t(got)};
  const bool whole = peer.vrpn
                         ? peer.vrpn->feed(view, [&](const vrpn::Message& message) { hear(peer, message); })
                         : peer.framer.feed(view, [&](const Message& message) { hear(peer, message); });
  const openigtlink::Counters& now = peer.cutter().counters();
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
  if (!peer.closing && !peer.replica && message.header.type.view() == openigtlink::get_string_type) {
    say_force(peer, message.header.device_name.view());
  } else if (peer.closing || replica_protocol::kind_of(message) != replica_protocol::Kind::word) {
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

void Publisher::say_force(Peer& peer, std::string_view name) {
  for (std::uint32_t i = 0; i < burrs_; ++i) {
    if (name != force_name[i] && !(name.empty() && i == 0)) continue;
    const Vec3 force = force_in_ras(newest_.burr[i]);
    std::ostringstream text;
    text.imbue(std::locale::classic());  // a decimal point, whatever the program's language
    text.precision(9);
    text << force[0] << ' ' << force[1] << ' ' << force[2];
    openigtlink::Envelope envelope;
    envelope.device_name = force_name[i];
    envelope.timestamp = openigtlink::timestamp_now();
    envelope.version = settings_.header_version;
    return encode_string(peer.pending, envelope, text.str());
  }
  ++status_.ignored;
}

void Publisher::hear(Peer& peer, const vrpn::Message& message) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (message.kind == vrpn::Kind::cookie && peer.vrpn->greeted()) {
    status_.vrpn_others += std::uint64_t(message.number);
    vrpn::encode_descriptions(peer.pending, names_of(burrs_));
    peer.tick = vrpn_log_.next();
  } else if (message.kind == vrpn::Kind::ping) {
    vrpn::encode_pong(peer.pending, std::int32_t(message.sender), openigtlink::timestamp_now());
  } else if (message.kind == vrpn::Kind::udp) {
    peer.poses = peer.address.with_port(message.number);
  } else if (message.kind != vrpn::Kind::sender) {
    ++status_.ignored;
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
  ++status_.replicas;  // before it is no longer missing, as `finish` waits for either
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

/// Gives the awaited state to this peer, if it is there.
bool Publisher::give_state(Peer& peer) {
  if (wants_state_ || !state_) return false;
  std::uint64_t at = 0;
  if (!log_.place_of(state_->tick, at) || (peer.suspect && state_->tick < peer.holds)) {
    wants_state_ = !ended_;  // too old, or the log was restarted
    return false;
  }
  // A suspect bone first gets the ticks until the state, so that the two can be compared.
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
  while (done < a_turn && !peer.connecting) {
    if (peer.idle()) {
      if (peer.closing) return false;
      peer.pending.clear();
      peer.sent = 0;
      if (!refill(peer)) return false;
      if (peer.pending.empty()) {
        if (!peer.vrpn || peer.vrpn->greeted()) peer.last_progress = now;  // a VRPN client must greet
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
  // A peer also falls behind while bytes are on their way.
  if (!peer.replica || !peer.caught_up || log_.end() - peer.place <= settings_.most_behind) return true;
  ++status_.cut_off;
  return false;
}

bool Publisher::refill(Peer& peer) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (peer.vrpn) return refill_vrpn(peer);
  return peer.replica ? refill_replica(peer) : refill_standard(peer);
}

/// The end of the ticks that a standard peer gets at once, from its next one on.
std::uint64_t Publisher::next_ticks(Peer& peer, const TickLog& log) {
  if (peer.tick > log.next()) peer.tick = log.next();
  if (log.next() - peer.tick > settings_.thin_after) {
    status_.skipped += log.next() - 1 - peer.tick;
    peer.tick = log.next() - 1;
  }
  return std::min(log.next(), peer.tick + ticks_at_once);
}

bool Publisher::refill_vrpn(Peer& peer) {
  if (!peer.vrpn->greeted()) return true;
  const std::size_t over_udp = peer.poses.size ? udp_size * burrs_ : 0;
  for (const std::uint64_t until = next_ticks(peer, vrpn_log_); peer.tick < until; ++peer.tick) {
    std::uint64_t from = 0, to = 0;
    if (!vrpn_log_.place_of(peer.tick, from) || !vrpn_log_.place_of(peer.tick + 1, to)) continue;
    if (over_udp) {
      scratch_.clear();
      vrpn_log_.copy(from, over_udp, scratch_);
      vrpn::number_messages(scratch_.data(), over_udp, peer.next_on_udp);
      status_.datagrams += vrpn_->datagrams.send(peer.poses, scratch_.data(), over_udp);
    }
    const std::size_t begin = peer.pending.size();
    vrpn_log_.copy(from + over_udp, std::size_t(to - from) - over_udp, peer.pending);
    vrpn::number_messages(peer.pending.data() + begin, peer.pending.size() - begin, peer.next_on_tcp);
  }
  return true;
}

bool Publisher::refill_standard(Peer& peer) {
  const std::uint64_t until = next_ticks(peer, poses_);
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

/// Says that there is nothing, so that silence means a broken connection; after the end, repeats the end.
void Publisher::say_idle(Peer& peer) {
  const bool first_end = ended_ && !peer.wants_state && !peer.told_end;
  if (!first_end && steady_now() - peer.last_queued < idle_every) return;
  if (ended_ && !peer.wants_state) {
    encode(peer.pending, settings_.header_version, end_);
    peer.told_end = true;
  } else {
    const std::uint64_t tick = peer.wants_state ? peer.holds : log_.next();  // the replica's by then
    encode(peer.pending, settings_.header_version, replica_protocol::Idle{tick});
  }
}

}  // namespace burrlab
