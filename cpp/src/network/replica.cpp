// A replica's connection, made as often as needed, and the effect of its messages on the bone.
#include "network/replica.hpp"

#include <algorithm>
#include <chrono>
#include <cstring>

#include "anatomy/anatomy_watch.hpp"
#include "require.hpp"
#include "session/realtime.hpp"
#include "wire.hpp"

namespace burrlab {

using openigtlink::Bytes;
using openigtlink::Message;
using replica_protocol::Holds;
using replica_protocol::Kind;
using replica_protocol::Word;

constexpr double silence = 1.0, until_hello = 0.5;  // after which a connection counts as lost [s]
constexpr std::size_t most_kept = 1000;             // faults, divergences

constexpr int most_repairs = 5;  // in a row without success, after which the session is given up

Replica::Replica(const std::string& host, int port) : client_(host, port) {}

bool Replica::fetch_hello(double timeout) {
  require_positive("timeout", timeout);
  const std::lock_guard<std::mutex> lock(life_mutex_);
  if (started_) throw InvalidArgument("hello must be fetched before the replica is started");
  const std::int64_t until = steady_after(timeout);
  const auto left = [until] { return 1e-9 * double(until - steady_now()); };
  bool found = false;
  do {
    framer_.restart();
    Bytes word;
    encode(word, 1, Word{});
    bool alive = client_.connect(std::max(left(), 0.001)) && client_.send(word.data(), word.size());
    std::uint8_t bytes[16384];
    while (alive && !found && left() > 0.0) {
      const std::size_t got = client_.receive(bytes, sizeof bytes, std::max(left(), 0.0));
      alive = got > 0 && framer_.feed({bytes, got}, [&](const Message& message) {
        replica_protocol::Hello hello;
        if (found || !decode(message, hello)) return;
        hello_ = hello;
        found = true;
      });
    }
    client_.close();
    if (!found && left() > 0.0 && !client_.pause(std::clamp(left(), 0.0, first_pause))) break;
  } while (!found && left() > 0.0);
  framer_.restart();
  return found;
}

void Replica::start(std::shared_ptr<VoxelBone> bone, const SessionSetup& setup,
                    std::shared_ptr<AnatomyWatch> watch) {
  const std::lock_guard<std::mutex> life(life_mutex_);
  if (started_) throw InvalidArgument("replica must be started once: it has been");
  if (!bone) throw InvalidArgument("bone must be a VoxelBone, got None");
  if (hello_.session == 0) throw InvalidArgument("hello must be fetched before the replica is started");
  if (hello_.version != replica_protocol::version && hello_.version != replica_protocol::law_version)
    refuse("version of the leader's protocol", "2 or 3", hello_.version);
  auto followed = std::make_unique<FollowedBone>(bone, setup, hello_.first_tick);
  if (followed->initial_digest().text() != hello_.digest)
    throw InvalidArgument("bone must be the leader's initial volume, digest " + hello_.digest + ", got " +
                          followed->initial_digest().text());
  followed->executor().set_watch(std::move(watch));
  const std::lock_guard<std::mutex> lock(mutex_);
  changing_ = std::make_unique<VoxelBone::Changing>(*bone);
  initial_ = std::make_unique<VoxelBone>(*bone);
  unseen_ = followed->view();
  bone_ = std::move(followed);
  status_.tick = hello_.first_tick;
  thread_ = std::thread([this] { run(); });
  started_ = true;
}

void Replica::stop(const std::string& reason) {
  client_.stop();
  {
    const std::lock_guard<std::mutex> lock(life_mutex_);
    if (thread_.joinable()) thread_.join();
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  end(reason, false);
}

bool Replica::wait(double seconds) {
  return wait_until(steady_after(seconds), std::chrono::milliseconds(2), [this] {
    const std::lock_guard<std::mutex> lock(mutex_);
    return status_.ended;
  });
}

void Replica::run() {
  double pause = first_pause;
  for (;;) {
    progress_ = false;
    if (client_.connect() && !follow()) send_word(Holds::all);
    client_.close();
    framer_.restart();
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      status_.connected = false;
      status_.received = framer_.counters();
      if (status_.ended) return;
    }
    // A replica that paused after each loss would never catch up where one message in a hundred is lost.
    if (!client_.pause(progress_ ? 0.0 : pause)) return;
    pause = progress_ ? first_pause : std::min(2.0 * pause, longest_pause);
  }
}

bool Replica::send_word(Holds holds) {
  Word word{holds, hello_.session, 0, hello_.digest};
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    word.tick = bone_->tick();
    if (holds == Holds::ticks && suspect_) word.holds = Holds::suspect;
  }
  Bytes bytes;
  encode(bytes, 1, word);
  return client_.send(bytes.data(), bytes.size());
}

/// Follows on one connection; returns whether to connect again.
bool Replica::follow() {
  stage_ = Stage::hello;
  broken_ = any_digest_ = false;
  only_hello_ = true;
  numbers_.clear();
  levels_.clear();
  if (!send_word(Holds::ticks)) return true;
  std::vector<std::uint8_t> bytes(65536);
  const std::int64_t begin = steady_now();
  const openigtlink::MessageFramer::Receive receive = [this](const Message& message) { take(message); };
  while (!broken_) {
    const std::size_t got = client_.receive(bytes.data(), bytes.size(), silence);
    const std::lock_guard<std::mutex> lock(mutex_);
    if (status_.ended || client_.stopped()) return false;
    if (got == 0) {
      give_up("the connection ended, or nothing came for 1 s");
      break;
    }
    const std::uint64_t dropped = framer_.counters().all_dropped();
    const bool whole = framer_.feed({bytes.data(), got}, receive);
    status_.received = framer_.counters();
    if (status_.ended) return false;
    if (!broken_ && (!whole || framer_.counters().all_dropped() > dropped))
      give_up(whole ? "a message had to be dropped" : "the framing was lost");
    if (!broken_ && stage_ == Stage::hello && 1e-9 * double(steady_now() - begin) > until_hello)
      give_up("no hello came");
  }
  return true;
}

void Replica::give_up(const std::string& reason, std::uint64_t seen) {
  if (broken_) return;
  broken_ = true;
  ++status_.faults;
  const std::uint64_t tick = bone_->tick();
  if (seen > tick) status_.most_missed = std::max(status_.most_missed, seen - tick);
  if (status_.last_faults.size() < most_kept) status_.last_faults.push_back({tick, seen, reason});
}

void Replica::end(const std::string& reason, bool failed) {
  if (status_.ended) return;
  changing_.reset();
  status_.ended = true;
  status_.failed = failed;
  status_.reason = reason;
}

FollowedBone& Replica::shared() const {
  if (!bone_) throw InvalidArgument("replica must be started first");
  return *bone_;
}

void Replica::take(const Message& message) {
  if (broken_ || status_.ended) return;
  const auto read = [&](auto content, auto handle) {
    if (decode(message, content))
      (this->*handle)(content);
    else
      give_up("a message could not be read");
  };
  const Kind kind = replica_protocol::kind_of(message);
  if (kind == Kind::other) return;  // poses and forces, sent before the leader knew this is a replica
  if (kind == Kind::hello) return read(replica_protocol::Hello{}, &Replica::take_hello);
  if (stage_ == Stage::hello) return give_up("the hello was lost");
  if (kind == Kind::idle) {
    replica_protocol::Idle idle;
    if (!decode(message, idle)) return give_up("a message could not be read");
    if (idle.tick != bone_->tick() || !numbers_.empty()) give_up("ticks were lost", idle.tick);
    return;
  }
  if (!numbers_.empty() && kind != Kind::bricks) return give_up("bricks were lost");
  if (only_hello_ && status_.connections > 1 && kind != Kind::bricks && !suspect_) ++status_.by_ticks;
  only_hello_ = false;
  if (kind == Kind::tick) return read(replica_protocol::TickMessage{}, &Replica::take_tick);
  if (kind == Kind::digest) return read(replica_protocol::Digest{}, &Replica::take_digest);
  if (kind == Kind::bricks) return read(replica_protocol::Bricks{}, &Replica::take_bricks);
  if (kind == Kind::end) return read(replica_protocol::End{}, &Replica::take_end);
  give_up("a message came that only replicas send");
}

void Replica::take_hello(const replica_protocol::Hello& hello) {
  if (hello.session != hello_.session) return end("the leader has begun another session", true);
  if (hello.version != hello_.version || hello.digest != hello_.digest ||
      hello.first_tick != hello_.first_tick)
    return give_up("the hello is not that of this session");
  stage_ = Stage::following;
  status_.connected = true;
  ++status_.connections;
}

void Replica::take_tick(const replica_protocol::TickMessage& tick) {
  const TickRecord& record = tick.record;
  if (record.index != bone_->tick()) return give_up("ticks were lost", record.index);
  const std::vector<Tool>& tools = bone_->executor().setup().tools;
  bool fits = record.burrs == tools.size();
  for (std::size_t i = 0; fits && i < tools.size(); ++i)
    fits = record.burr[i].radius == tools[i].burr.radius && record.burr[i].material == i;
  if (!fits) return give_up("a tick is not of these burrs");
  if (any_digest_ && tick.digest_tick != digest_tick_) return give_up("a digest was lost", record.index);
  any_digest_ = true;
  digest_tick_ = tick.digest_tick;
  const Difference difference = bone_->execute(record);
  progress_ = true;
  status_.tick = bone_->tick();
  if (suspect_) return;  // known to differ: bricks are on their way
  if (difference) {
    ++status_.differing_ticks;
    diverge(std::string(difference.field) + " of burr " + std::to_string(difference.burr));
  }
}

void Replica::take_digest(const replica_protocol::Digest& digest) {
  if (digest.tick != bone_->tick()) return give_up("ticks were lost", digest.tick);
  any_digest_ = true;
  digest_tick_ = digest.tick;
  if (suspect_) return;
  if (bone_->digest().text() == digest.digest) {
    ++status_.digests_equal;
    repairs_ = 0;
    return;
  }
  ++status_.digests_different;
  diverge("digest");
}

void Replica::diverge(const std::string& what) {
  suspect_ = true;
  divergence_ = {};
  divergence_.tick = bone_->tick();
  divergence_.what = what;
  give_up("the bone is not the leader's: another " + what);
}

void Replica::take_bricks(const replica_protocol::Bricks& bricks) {
  const std::size_t count = bone_->bone().brick_count();
  const bool begins = bricks.first == 0 && numbers_.empty();
  const bool goes_on = bricks.first == numbers_.size() && bricks.tick == incoming_.tick &&
                       bricks.total == incoming_.total && bricks.digest == incoming_.digest;
  if (bricks.total > count || !(begins || goes_on)) return give_up("bricks were lost");
  incoming_ = bricks;
  const openigtlink::ByteView& view = bricks.bricks;
  for (std::size_t at = 0; at < view.size; at += replica_protocol::brick_bytes) {
    const std::uint32_t number = openigtlink::get<std::uint32_t>(view.data + at);
    if (number >= count || (!numbers_.empty() && number <= numbers_.back()))
      return give_up("a message could not be read");
    numbers_.push_back(number);
    levels_.insert(levels_.end(), view.data + at + 4, view.data + at + replica_protocol::brick_bytes);
  }
  if (numbers_.size() == bricks.total) put_bricks();
}

/// Sets the bone to the initial volume with the received bricks, and notes the bricks that differed.
void Replica::put_bricks() {
  VoxelBone& bone = bone_->bone();
  std::uint8_t present[2 * brick_voxels], received[2 * brick_voxels];
  std::vector<std::uint32_t> differing;
  std::size_t next = 0;
  for (std::size_t brick = 0; brick < bone.brick_count(); ++brick) {
    bone.read_brick(brick, present, present + brick_voxels);
    if (next < numbers_.size() && numbers_[next] == brick)
      std::memcpy(received, levels_.data() + 2 * brick_voxels * next++, sizeof received);
    else
      initial_->read_brick(brick, received, received + brick_voxels);
    if (std::memcmp(present, received, sizeof present) == 0) continue;
    try {
      bone.write_brick(brick, received, received + brick_voxels);
    } catch (const std::invalid_argument&) {  // levels no bone has
      suspect_ = true;
      return give_up("a message could not be read");
    }
    differing.push_back(std::uint32_t(brick));
  }
  numbers_.clear();
  levels_.clear();
  ++status_.by_bricks;
  if (suspect_ && divergence_.bricks.empty() && !divergence_.what.empty()) {
    divergence_.compared_at = incoming_.tick;
    divergence_.exact = incoming_.tick == bone_->tick();
    divergence_.bricks = std::move(differing);
    if (status_.divergences.size() < most_kept) status_.divergences.push_back(divergence_);
    divergence_ = {};
  }
  suspect_ = false;
  bone_->executor().set_tick(incoming_.tick);
  status_.tick = incoming_.tick;
  if (bone_->digest().text() == incoming_.digest) return;
  if (++repairs_ >= most_repairs) return end("the bone cannot be made equal to the leader's", true);
  diverge("digest");
}

void Replica::take_end(const replica_protocol::End& last) {
  if (last.tick != bone_->tick()) return give_up("ticks were lost", last.tick);
  if (bone_->digest().text() != last.digest) {
    ++status_.digests_different;
    return diverge("digest");
  }
  ++status_.digests_equal;
  end(last.reason, last.failed != 0);
}

BoneUpdate Replica::take_changed() {
  const std::lock_guard<std::mutex> lock(mutex_);
  return shared().take_changed(*unseen_);
}

}  // namespace burrlab
