// The follower's side of a publisher: each tick becomes bytes, once, whatever the number of peers.
#include "burrlab/network/publisher.hpp"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <random>

#include "burrlab/check.hpp"
#include "burrlab/network/bone_frame.hpp"
#include "publisher_peer.hpp"

namespace burrlab {

using openigtlink::Bytes;
using openigtlink::ByteView;

namespace {

constexpr std::size_t largest_head = 130, largest_burr = 88;  // of a tick's message, either version [bytes]
constexpr std::size_t largest_pose = 260, poses_kept = 1024;  // of one burr; ticks
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
  return settings;
}

std::size_t ticks_of_log(double seconds, double period) {
  const double ticks = std::ceil(seconds * 1e3 / period);
  if (!(ticks <= 2e6)) refuse("ticks of the log", "at most 2000000", ticks);
  return std::size_t(ticks);
}

std::uint64_t random_number() {
  std::random_device device;
  for (;;)
    if (const std::uint64_t number = (std::uint64_t(device()) << 32) | device()) return number;
}

/// What the publisher needs to know of its follower.
struct Beginning {
  std::size_t burrs = 0;
  double period = 0.0;
  std::uint64_t tick = 0;
  std::string digest;

  explicit Beginning(Follower& follower) {
    follower.visit([this](FollowedBone& bone) {
      burrs = bone.executor().burrs();
      period = bone.executor().setup().period;
      tick = bone.tick();
      digest = bone.initial_digest().text();
    });
  }
};

}  // namespace

Publisher::Publisher(Follower& follower, const PublisherSettings& settings)
    : settings_(checked(settings)),
      session_(random_number()),
      burrs_(std::uint32_t(Beginning(follower).burrs)),
      server_(settings.host, settings.port, send_buffer),
      log_(1, 1, 0),
      poses_(poses_kept * largest_pose * burrs_, poses_kept, 0) {
  const Beginning begin(follower);
  const std::size_t ticks = ticks_of_log(settings.log, begin.period);
  log_ = TickLog(ticks * (largest_head + largest_burr * burrs_) + 65536, ticks, begin.tick);
  poses_.restart(begin.tick);
  hello_ = {replica_protocol::version, session_, begin.tick, begin.digest, settings.hello};
  digest_tick_ = begin.tick;
  status_.tick = begin.tick;
  thread_ = std::thread([this] { run(); });
}

void Publisher::stop() {
  stopping_.store(true);
  server_.wake();
  const std::lock_guard<std::mutex> lock(life_mutex_);
  if (thread_.joinable()) thread_.join();
}

PublisherStatus Publisher::status() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return status_;
}

void Publisher::on_tick(const TickRecord& record) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (ended_) return;
  scratch_.clear();
  encode(scratch_, settings_.header_version, replica_protocol::TickMessage{record, digest_tick_});
  log_.append_tick({scratch_.data(), scratch_.size()});

  scratch_.clear();
  static constexpr std::string_view burr_name[] = {"burrlab_burr_0", "burrlab_burr_1"};
  static constexpr std::string_view force_name[] = {"burrlab_force_0", "burrlab_force_1"};
  openigtlink::Envelope envelope;
  envelope.timestamp = openigtlink::timestamp_now();
  envelope.version = settings_.header_version;
  for (std::uint32_t i = 0; i < burrs_; ++i) {
    const BurrRecord& burr = record.burr[i];
    const Vec3 center(burr.center[0], burr.center[1], burr.center[2]);
    if (openigtlink::is_plausible(center)) {
      envelope.device_name = burr_name[i];
      encode_transform(scratch_, envelope, openigtlink::to_ras(center));
    } else {
      ++status_.out_of_range;
    }
    const double force[3] = {0.0 - burr.force[0], 0.0 - burr.force[1], burr.force[2]};
    envelope.device_name = force_name[i];
    encode_sensor(scratch_, envelope, force, 3);
  }
  poses_.append_tick({scratch_.data(), scratch_.size()});
  status_.tick = record.index + 1;
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

/// Replicas that ask and ask cost the follower little, and those that take their bricks slowly little memory.
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

}  // namespace burrlab
