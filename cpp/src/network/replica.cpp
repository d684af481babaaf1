// A replica's connection: made, kept, made anew. What the messages do to the bone is in replica_bone.cpp.
#include "burrlab/network/replica.hpp"

#include <algorithm>
#include <chrono>

#include "burrlab/check.hpp"
#include "burrlab/session/realtime.hpp"

namespace burrlab {

using openigtlink::Bytes;
using openigtlink::Message;
using replica_protocol::Holds;
using replica_protocol::Kind;
using replica_protocol::Word;

namespace {

constexpr double first_pause = 0.1, longest_pause = 1.0;  // between connections [s]
constexpr double silence = 1.0, until_hello = 0.5;        // after which a connection counts as lost [s]
constexpr std::size_t most_kept = 1000;                   // faults

}  // namespace

Replica::Replica(const std::string& host, int port) : client_(host, port) {}

bool Replica::fetch_hello(double timeout) {
  require_positive("timeout", timeout);
  const std::lock_guard<std::mutex> lock(life_mutex_);
  if (started_) throw std::invalid_argument("hello must be fetched before the replica is started");
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
  if (started_) throw std::invalid_argument("replica must be started once: it has been");
  if (!bone) throw std::invalid_argument("bone must be a VoxelBone, got None");
  if (hello_.session == 0) throw std::invalid_argument("hello must be fetched before the replica is started");
  if (hello_.version != replica_protocol::version)
    refuse("version of the leader's protocol", std::to_string(replica_protocol::version), hello_.version);
  auto followed = std::make_unique<FollowedBone>(bone, setup, hello_.first_tick);
  if (followed->initial_digest().text() != hello_.digest)
    throw std::invalid_argument("bone must be the leader's initial volume, digest " + hello_.digest +
                                ", got " + followed->initial_digest().text());
  followed->executor().set_watch(std::move(watch));
  const std::lock_guard<std::mutex> lock(mutex_);
  changing_ = std::make_unique<VoxelBone::Changing>(*bone);
  initial_ = std::make_unique<VoxelBone>(*bone);
  unseen_ = std::make_shared<UnseenBricks>(bone->brick_count());
  consumers_.push_back(unseen_);
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
  const std::int64_t until = steady_after(seconds);
  for (;;) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (status_.ended) return true;
    }
    if (steady_now() >= until) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
}

void Replica::run() {
  double pause = first_pause;
  for (;;) {
    progress_ = false;
    if (client_.connect() && !follow()) say_word(Holds::all);
    client_.close();
    framer_.restart();
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      status_.connected = false;
      status_.received = framer_.counters();
      if (status_.ended) return;
    }
    // Where one message in a hundred is lost, a pause after each loss would never let it catch up.
    if (!client_.pause(progress_ ? 0.0 : pause)) return;
    pause = progress_ ? first_pause : std::min(2.0 * pause, longest_pause);
  }
}

bool Replica::say_word(Holds holds) {
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

/// Whether it is to come back.
bool Replica::follow() {
  stage_ = Stage::hello;
  broken_ = any_digest_ = false;
  first_ = true;
  numbers_.clear();
  levels_.clear();
  if (!say_word(Holds::ticks)) return true;
  std::vector<std::uint8_t> bytes(65536);
  const std::int64_t begin = steady_now();
  const openigtlink::MessageFramer::Receive receive = [this](const Message& message) { take(message); };
  while (!broken_) {
    const std::size_t got = client_.receive(bytes.data(), bytes.size(), silence);
    const std::lock_guard<std::mutex> lock(mutex_);
    if (status_.ended || client_.stopped()) return false;
    if (got == 0) {
      fault("the connection ended, or nothing came for 1 s");
      break;
    }
    const std::uint64_t dropped = framer_.counters().all_dropped();
    const bool whole = framer_.feed({bytes.data(), got}, receive);
    status_.received = framer_.counters();
    if (status_.ended) return false;
    if (!broken_ && (!whole || framer_.counters().all_dropped() > dropped))
      fault(whole ? "a message had to be dropped" : "the framing was lost");
    if (!broken_ && stage_ == Stage::hello && 1e-9 * double(steady_now() - begin) > until_hello)
      fault("no hello came");
  }
  return true;
}

void Replica::fault(const std::string& reason, std::uint64_t seen) {
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

FollowedBone& Replica::followed() const {
  if (!bone_) throw std::invalid_argument("replica must be started first");
  return *bone_;
}

ReplicaStatus Replica::status() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return status_;
}

TickRecord Replica::newest() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return newest_;
}

std::string Replica::digest() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  FollowedBone& followed = this->followed();
  return followed.digest().text();
}

std::shared_ptr<VoxelBone> Replica::snapshot(std::uint64_t& tick) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  tick = followed().tick();
  return std::make_shared<VoxelBone>(followed().bone());
}

void Replica::visit(const std::function<void(FollowedBone&)>& function) {
  const std::lock_guard<std::mutex> lock(mutex_);
  function(followed());
}

const VoxelBone& Replica::bone() const { return followed().bone(); }

}  // namespace burrlab
