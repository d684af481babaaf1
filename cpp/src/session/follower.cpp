#include "session/follower.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "require.hpp"
#include "session/realtime.hpp"

namespace burrlab {

constexpr std::size_t batch = 256;  // ticks between other work

Follower::Follower(std::shared_ptr<HapticLoop> loop, const FollowerSettings& settings)
    : loop_(std::move(loop)),
      settings_(settings),
      reader_(std::make_shared<RecordReader>(loop_->ring())),
      bone_(std::make_shared<VoxelBone>(*loop_->executor()->bone()), loop_->executor()->setup(),
            loop_->executor()->tick()) {
  if (settings.digest_every < 1) refuse("digest_every", "at least 1", 0.0);
  require_positive("stiffness_every", settings.stiffness_every);
  require_positive("rebuild_after", settings.rebuild_after);
  loop_->add_reader(reader_);
  status_.tick = bone_.tick();
  digests_.push_back({bone_.tick(), bone_.digest().text()});
}

Follower::~Follower() {
  abandoned_.store(true);
  stop();
}

void Follower::add(std::shared_ptr<TickListener> listener) {
  if (started_.load()) throw InvalidArgument("listener must be added before the follower is started");
  listeners_.push_back(std::move(listener));
}

void Follower::start() {
  const std::lock_guard<std::mutex> lock(life_mutex_);
  if (!started_.exchange(true)) thread_ = std::thread([this] { run(); });
}

void Follower::stop() {
  stopping_.store(true);
  const std::lock_guard<std::mutex> lock(life_mutex_);
  if (thread_.joinable()) thread_.join();
}

void Follower::run() {
  for (;;) {
    if (abandoned_.load()) return;
    const bool last = stopping_.load() && !loop_->running();
    const bool worked = execute_batch();
    if (last && !worked) break;
    if (!worked) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  for (const auto& listener : listeners_) listener->on_end();
  if (digests_.back().tick == bone_.tick()) return;
  digests_.push_back({bone_.tick(), bone_.digest().text()});
  for (const auto& listener : listeners_) listener->on_digest(bone_.tick(), bone_.digest());
}

bool Follower::execute_batch() {
  const std::lock_guard<std::mutex> lock(mutex_);
  const double behind = 1e-3 * loop_->executor()->setup().period * double(reader_->behind());
  status_.most_behind = std::max(status_.most_behind, behind);
  TickRecord record;
  std::size_t done = 0;
  const bool too_far = loop_->settings().wall_clock && behind > settings_.rebuild_after;
  if (too_far || rebuild_asked_.exchange(false)) {
    rebuild();
  } else {
    RecordReader::Result result = RecordReader::Result::none;
    while (done < batch && (result = reader_->next(record)) == RecordReader::Result::record) {
      execute(record);
      ++done;
    }
    if (result == RecordReader::Result::lost) rebuild();
  }
  status_.tick = bone_.tick();
  status_.behind = reader_->behind();
  measure_stiffness();
  for (const auto& listener : listeners_) listener->on_bone(bone_);
  return done > 0;
}

void Follower::execute(const TickRecord& record) {
  if (const Difference difference = bone_.execute(record)) {
    if (status_.differing++ == 0)
      status_.first_difference = std::string(difference.field) + " of burr " +
                                 std::to_string(difference.burr) + " in tick " + std::to_string(record.index);
  }
  for (const auto& listener : listeners_) listener->on_tick(record);
  if (bone_.tick() % settings_.digest_every) return;
  digests_.push_back({bone_.tick(), bone_.digest().text()});
  for (const auto& listener : listeners_) listener->on_digest(bone_.tick(), bone_.digest());
}

// Copies the loop's bone between two of its ticks, while the loop runs. Copies all bricks, then those that
// ticks may have touched since, until no tick began meanwhile. What was read during a write is dropped.
void Follower::rebuild() {
  const TickExecutor& leader = *loop_->executor();
  const VoxelBone& theirs = *leader.bone();
  VoxelBone& mine = bone_.bone();
  const auto ring = loop_->ring();
  std::uint64_t from = ring->count();
  for (std::size_t brick = 0; brick < mine.brick_count(); ++brick) mine.copy_brick(brick, theirs);
  for (;;) {
    const std::uint64_t version = leader.version();
    if (version & 1) continue;
    const std::uint64_t tick = version / 2, until = tick - loop_->first_tick();
    if (ring->count() < until && loop_->running()) continue;  // the last tick's record is still missing
    Vec3 low = Vec3::Constant(1e300), high = -low;
    bool lost = false;
    TickRecord record;
    for (std::uint64_t number = from; number < until && !lost; ++number) {
      lost = !ring->read(number, record);
      for (std::size_t i = 0; i < bone_.executor().burrs() && !lost; ++i) {
        const double reach = record.burr[i].radius + mine.spacing().maxCoeff();
        low = low.cwiseMin(to_vector(record.burr[i].center) - Vec3::Constant(reach));
        high = high.cwiseMax(to_vector(record.burr[i].center) + Vec3::Constant(reach));
      }
    }
    if (lost) {
      from = until;
      for (std::size_t brick = 0; brick < mine.brick_count(); ++brick) mine.copy_brick(brick, theirs);
      continue;
    }
    for (const std::uint32_t brick : mine.bricks_between(low, high)) mine.copy_brick(brick, theirs);
    std::atomic_thread_fence(std::memory_order_acquire);
    if (leader.version() != version) {
      from = until;  // the copy is whole except where later ticks were
      continue;
    }
    bone_.executor().set_tick(tick);
    reader_->skip_to(until);
    if (until > 0 && ring->read(until - 1, record)) bone_.set_newest(record);
    ++status_.rebuilds;
    for (const auto& listener : listeners_) listener->on_rebuild(tick);
    return;
  }
}

void Follower::measure_stiffness() {
  const std::int64_t now = steady_now();
  if (!bone_.newest() || double(now - last_stiffness_) < 1e6 * settings_.stiffness_every) return;
  last_stiffness_ = now;
  for (std::size_t i = 0; i < bone_.executor().burrs(); ++i) {
    const BurrRecord& burr = bone_.newest()->burr[i];
    const Vec3 center = to_vector(burr.center);
    stiffness_[i] = {bone_.tick(),
                     measured_stiffness(bone_.executor(), i, center),
                     stiffest_contact(bone_.executor(), i, center),
                     to_vector(burr.force).norm(),
                     burr.age,
                     bone_.executor().probe(i, center).c_e};
  }
}

FollowerStatus Follower::status() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  FollowerStatus status = status_;
  status.behind = reader_->behind();
  return status;
}

std::vector<DigestAt> Follower::digests(std::size_t from) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return {digests_.begin() + std::ptrdiff_t(std::min(from, digests_.size())), digests_.end()};
}

StiffnessAt Follower::stiffness(std::size_t burr) const {
  if (burr >= bone_.executor().burrs())
    refuse("burr", "below " + std::to_string(bone_.executor().burrs()), double(burr));
  const std::lock_guard<std::mutex> lock(mutex_);
  return stiffness_[burr];
}

StabilityReport Follower::stability(std::size_t burr) const {
  const StiffnessAt at = stiffness(burr);
  const SessionSetup& setup = loop_->executor()->setup();
  const double spring = loop_->settings().coupling;
  Tool tool = setup.tools[burr];
  if (at.c_e > 0.0) tool.material.c_e = at.c_e;  // with tissues: of those it touches
  const auto& frames = loop_->settings().frames;
  const double scale = frames.empty() ? 1.0 : frames[burr].scale;  // the hand meets more force a mm
  const DeviceModel model = loop_->model(burr);
  const double late = std::isnan(model.delay) ? at.age : std::max(0.0, model.delay - 0.5 * setup.period);
  const auto report_of = [&](double k) {
    return stability_report(at.force, scale * k, tool, model, setup.period, late,
                            spring > 0.0 ? scale * spring : std::numeric_limits<double>::infinity());
  };
  // Where a thin wall gives way the force falls on the way in: no spring, and no limit.
  StabilityReport report = report_of(std::max(at.stiffness, 0.0));
  const StabilityReport worst = report_of(std::max({at.stiffness, at.stiffest, 0.0}));
  report.ratio = worst.ratio;
  report.warning = worst.warning;
  return report;
}

}  // namespace burrlab
