#include "replica_service.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include "require.hpp"
#include "session/realtime.hpp"
#include "wire.hpp"

namespace burrlab {

using replica_protocol::Holds;
using replica_protocol::Word;

namespace {

constexpr std::size_t largest_head = 130, largest_burr = 128;  // of a tick's message, either version [bytes]
constexpr std::size_t chunk = 65536;                           // bytes taken from the log at once
constexpr int replica_send_buffer = 65536;                     // of the system [bytes]
constexpr std::size_t most_states = 4;                         // of the bone in memory at once
constexpr std::int64_t state_pause = second / 10;              // between two states [ns]
constexpr std::int64_t idle_every = second / 5;
constexpr std::int64_t grace = 3 * second;  // for a replica to come after its hello, or to come back

std::uint64_t random_number() {
  std::random_device device;
  for (;;)
    if (const std::uint64_t number = (std::uint64_t(device()) << 32) | device()) return number;
}

/// The number that makes a replica refuse which passes over exponents, as it would carve another bone.
std::uint32_t protocol_of(const std::vector<Tool>& tools) {
  const bool paper = std::all_of(tools.begin(), tools.end(), [](const Tool& tool) {
    return tool.material.force_exponent == Material::paper_force_exponent &&
           tool.material.rate_exponent == 0.0;
  });
  return paper ? replica_protocol::version : replica_protocol::law_version;
}

TickLog log_for(const PublishedSession& session) {
  const double ticks = std::ceil(session.settings.log * 1e3 / session.period);
  if (!(ticks <= 2e6)) refuse("ticks of the log", "at most 2000000", ticks);
  const auto count = std::size_t(ticks);
  return {count * (largest_head + largest_burr * session.burrs) + 65536, count, session.status.tick};
}

}  // namespace

ReplicaService::ReplicaService(PublishedSession& session, const FollowedBone& bone)
    : session_(session),
      hello_{protocol_of(bone.executor().setup().tools), random_number(), session.status.tick,
             bone.initial_digest().text(), session.settings.hello},
      log_(log_for(session)),
      digest_tick_(session.status.tick) {}

void ReplicaService::append_tick(const TickRecord& record) {
  bytes_.clear();
  append(bytes_, replica_protocol::TickMessage{record, digest_tick_});
  log_.append_tick({bytes_.data(), bytes_.size()});
}

void ReplicaService::append_digest(std::uint64_t tick, const Hash128& digest) {
  bytes_.clear();
  append(bytes_, replica_protocol::Digest{tick, digest.text()});
  log_.append({bytes_.data(), bytes_.size()});
  digest_tick_ = tick;
}

void ReplicaService::take_awaited_state(FollowedBone& bone) {
  {
    const std::lock_guard<std::mutex> lock(session_.mutex);
    if (!wants_state_ || session_.ended || !may_take_state()) return;
  }
  std::shared_ptr<const State> state = take_state(bone);
  const std::lock_guard<std::mutex> lock(session_.mutex);
  states_.push_back(state);
  last_state_ = steady_now();
  state_ = std::move(state);
  wants_state_ = false;
}

/// Limits the follower's work for replicas that keep asking, and the memory for slow ones.
bool ReplicaService::may_take_state() {
  states_.erase(std::remove_if(states_.begin(), states_.end(), [](const auto& s) { return s.expired(); }),
                states_.end());
  return states_.size() < most_states && steady_now() - last_state_ > state_pause;
}

std::shared_ptr<const ReplicaService::State> ReplicaService::take_state(FollowedBone& bone) {
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

void ReplicaService::end(FollowedBone& bone, const std::string& reason, bool failed) {
  std::shared_ptr<const State> state = take_state(bone);
  const std::lock_guard<std::mutex> lock(session_.mutex);
  end_ = {state->tick, state->digest, failed ? 1u : 0u, reason.substr(0, 10000)};
  state_ = std::move(state);
  wants_state_ = false;
  session_.ended = true;
}

std::unique_ptr<ReplicaStream> ReplicaService::answer(Peer& peer, const Word& word) {
  append(peer.pending, hello_);
  if (word.holds == Holds::nothing || word.holds == Holds::all || word.session != hello_.session ||
      word.digest != hello_.digest) {
    ++session_.status.hellos;
    if (word.holds == Holds::nothing) missing_.push_back(steady_now() + grace);
    return nullptr;
  }
  TcpServer::set_send_buffer(peer.socket, replica_send_buffer);
  if (!missing_.empty()) missing_.erase(missing_.begin());
  return std::make_unique<ReplicaStream>(*this, peer, word);
}

/// Those that have not come back are awaited no more, and no state is taken or kept for those that left.
void ReplicaService::forget_lost_replicas() {
  const std::int64_t now = steady_now();
  missing_.erase(std::remove_if(missing_.begin(), missing_.end(), [now](auto until) { return until < now; }),
                 missing_.end());
  const bool awaited =
      std::any_of(streams_.begin(), streams_.end(), [](const auto* stream) { return stream->wants_state(); });
  wants_state_ = wants_state_ && awaited;
  if (!awaited && !session_.ended) state_.reset();
}

ReplicaStream::ReplicaStream(ReplicaService& service, Peer& peer, const Word& word)
    : service_(service), peer_(peer), held_tick_(word.tick) {
  const bool in_log = service_.log_.place_of(word.tick, place_);
  if (in_log && word.holds == Holds::ticks) {
    ++service_.session_.status.by_ticks;
  } else {
    suspect_ = in_log;
    wants_state_ = true;
    if (!service_.session_.ended) service_.wants_state_ = true;
  }
  service_.streams_.push_back(this);
}

ReplicaStream::~ReplicaStream() {
  auto& streams = service_.streams_;
  streams.erase(std::find(streams.begin(), streams.end(), this));
}

bool ReplicaStream::take(const Word& word) {
  left_ = left_ || word.holds == Holds::all;
  return word.holds == Holds::all;
}

/// A replica that left without saying so will come back, even if told the end: it may have missed it.
void ReplicaStream::leave() {
  if (!left_) service_.missing_.push_back(steady_now() + grace);
}

/// The log no longer holds what it needs, also if the follower was rebuilt; or it fell behind.
bool ReplicaStream::too_slow() const {
  const TickLog& log = service_.log_;
  const bool behind = caught_up_ && log.end() - place_ > service_.session_.settings.most_behind;
  return !wants_state_ && (place_ < log.begin() || behind);
}

void ReplicaStream::refill() {
  const TickLog& log = service_.log_;
  if (wants_state_ && !begin_state()) return append_idle();
  if (log.end() - place_ <= service_.session_.settings.most_behind / 2 && !state_) caught_up_ = true;
  if (state_ && place_ == state_place_) return append_bricks();
  const std::uint64_t until = state_ ? state_place_ : log.end();
  place_ += log.copy(place_, std::size_t(std::min<std::uint64_t>(until - place_, chunk)), peer_.pending);
  if (peer_.pending.empty()) append_idle();
}

/// Takes the awaited state for this replica, if it is there.
bool ReplicaStream::begin_state() {
  if (service_.wants_state_ || !service_.state_) return false;
  std::uint64_t at = 0;
  if (!service_.log_.place_of(service_.state_->tick, at) ||
      (suspect_ && service_.state_->tick < held_tick_)) {
    service_.wants_state_ = !service_.session_.ended;  // too old, or the log was restarted
    return false;
  }
  // A suspect bone first gets the ticks until the state, so that the two can be compared.
  if (!suspect_ || !service_.log_.place_of(held_tick_, place_)) place_ = at;
  state_ = service_.state_;
  state_place_ = at;
  wants_state_ = false;
  ++service_.session_.status.by_bricks;
  return true;
}

void ReplicaStream::append_bricks() {
  const std::size_t count = state_->bricks.size();
  replica_protocol::Bricks message{
      state_->tick, state_->digest, std::uint32_t(count), std::uint32_t(next_brick_), {}};
  const std::size_t until = std::min(next_brick_ + replica_protocol::bricks_a_message, count);
  openigtlink::Bytes content;
  openigtlink::ByteWriter writer(content);
  for (; next_brick_ < until; ++next_brick_) {
    writer.number(state_->bricks[next_brick_]);
    writer.bytes(state_->levels.data() + next_brick_ * 2 * brick_voxels, 2 * brick_voxels);
  }
  message.bricks = {content.data(), content.size()};
  service_.append(peer_.pending, message);
  if (next_brick_ == count) state_.reset();
}

/// Says that there is nothing, so that silence means a broken connection; after the end, repeats the end.
void ReplicaStream::append_idle() {
  const bool at_end = service_.session_.ended && !wants_state_;
  if ((!at_end || told_end_) && steady_now() - peer_.last_queued < idle_every) return;
  if (at_end)
    service_.append(peer_.pending, service_.end_);
  else  // the tick that the replica has executed by then
    service_.append(peer_.pending, replica_protocol::Idle{wants_state_ ? held_tick_ : service_.log_.next()});
  told_end_ = at_end;
}

}  // namespace burrlab
