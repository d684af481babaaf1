// The life of a loop: its start, its ends, its watchdog and what it says of itself.
#include "burrlab/session/haptic_loop.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <exception>

#include "burrlab/check.hpp"

namespace burrlab {
namespace {

std::int64_t to_nanoseconds(double milliseconds) { return std::llround(milliseconds * 1e6); }

std::size_t ring_size(const LoopSettings& settings, double period) {
  const double rate = 1e3 / period;
  if (!(rate <= 10001.0)) refuse("rate", "at most 10000 Hz", rate);
  require_positive("ring", settings.ring);
  const double records = settings.ring * 1e3 / period;
  if (!(records <= 4e6)) refuse("records of the ring", "at most 4000000", records);
  return std::max<std::size_t>(std::size_t(records), 256);
}

}  // namespace

HapticLoop::HapticLoop(std::shared_ptr<TickExecutor> executor, std::vector<std::shared_ptr<Device>> devices,
                       const LoopSettings& settings)
    : executor_(std::move(executor)),
      devices_(std::move(devices)),
      settings_(settings),
      period_(to_nanoseconds(executor_->setup().period)),
      first_tick_(executor_->tick()),
      ring_(std::make_shared<RecordRing>(ring_size(settings, executor_->setup().period))) {
  if (devices_.size() != executor_->burrs())
    refuse("number of devices", "one a burr, " + std::to_string(executor_->burrs()), double(devices_.size()));
  for (const auto& device : devices_)
    if (!device) throw std::invalid_argument("device must be a Device, got None");
  require_positive("stall_limit", settings.stall_limit);
  if (settings.wall_clock && executor_->setup().period > 0.5 * settings.stall_limit)
    refuse("period", "at most half the limit of a stall on the wall clock", executor_->setup().period);
  record_.burrs = std::uint32_t(devices_.size());
  guards_.assign(devices_.size(), ForceGuard(settings.force_limit, settings.slew_limit));
  if (settings.coupling != 0.0) couplings_.assign(devices_.size(), VirtualCoupling(settings.coupling));
  observers_.resize(devices_.size());
}

HapticLoop::~HapticLoop() { stop(); }

void HapticLoop::wait_for(std::shared_ptr<const RecordReader> reader) {
  if (started()) throw std::invalid_argument("reader must be added before the loop is started");
  readers_.push_back(reader);
}

void HapticLoop::start() {
  const std::lock_guard<std::mutex> lock(life_mutex_);
  if (started()) throw std::invalid_argument("loop must be started once: it has been");
  auto changing = std::make_unique<VoxelBone::Changing>(*executor_->bone());
  claim_devices();
  changing_ = std::move(changing);
  running_.store(true, std::memory_order_release);
  started_.store(true, std::memory_order_release);
  try {
    executor_->bone()->touch();
    for (const auto& device : devices_) device->start(1e-3 * executor_->setup().period);
    thread_ = std::thread([this] { run(); });
    while (heartbeat_.load(std::memory_order_acquire) == 0)
      std::this_thread::sleep_for(std::chrono::microseconds(100));
    if (settings_.wall_clock) watchdog_ = std::thread([this] { watch(); });
  } catch (const std::exception& error) {  // of a device, or a system that gives no thread
    end(std::string("the loop could not be started: ") + error.what(), true);
    if (!thread_.joinable()) {
      stop_devices();
      changing_.reset();
      running_.store(false, std::memory_order_release);
    }
    join();
    throw;
  }
}

void HapticLoop::stop(const std::string& reason) {
  const std::lock_guard<std::mutex> lock(life_mutex_);
  if (!started()) return;
  if (running()) end(reason.empty() ? "stopped" : reason, false);
  join();
}

/// The devices are free for another loop only when nobody of this one can halt them any more.
void HapticLoop::join() {
  stopping_.store(true, std::memory_order_release);
  if (thread_.joinable()) thread_.join();
  if (watchdog_.joinable()) watchdog_.join();
  if (claimed_)
    for (const auto& device : devices_) device->release();
  claimed_ = false;
}

void HapticLoop::claim_devices() {
  for (std::size_t i = 0; i < devices_.size(); ++i) {
    if (devices_[i]->claim()) continue;
    for (std::size_t j = 0; j < i; ++j) devices_[j]->release();
    throw std::invalid_argument("device " + std::to_string(i) +
                                " must serve one burr of one session at a time: it serves another");
  }
  claimed_ = true;
}

bool HapticLoop::wait(double seconds) {
  const std::int64_t until = steady_after(seconds);
  const auto ended = [this] { return started() && !running(); };
  while (!ended() && steady_now() < until) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  return ended();
}

void HapticLoop::end(const std::string& reason, bool failed) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!reason_.empty()) return;  // the first reason is the one
  reason_ = reason;
  failed_ = failed;
}

std::string HapticLoop::reason() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return reason_;
}

bool HapticLoop::failed() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return failed_;
}

std::vector<std::string> HapticLoop::realtime_notes() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return notes_;
}

LoopCounts HapticLoop::counts() const {
  constexpr auto relaxed = std::memory_order_relaxed;
  return {ticks_.load(relaxed), late_.load(relaxed), missed_.load(relaxed), dropped_.load(relaxed)};
}

EnergyGiven HapticLoop::energy(std::size_t burr) const {
  if (burr >= devices_.size()) refuse("burr", "below " + std::to_string(devices_.size()), double(burr));
  return {energy_[burr].load(std::memory_order_relaxed), most_energy_[burr].load(std::memory_order_relaxed)};
}

void HapticLoop::halt_devices() noexcept {
  for (const auto& device : devices_) device->halt();
}

/// All are at zero before the first is stopped: that may take a while.
void HapticLoop::stop_devices() noexcept {
  for (const auto& device : devices_) device->write(Vec3::Zero());
  halt_devices();
  for (const auto& device : devices_) device->stop();
}

// A stalled loop cannot send zero itself.
void HapticLoop::watch() {
  RealtimeRequest request = settings_.realtime;
  request.lock_memory = false;
  request.cpu = -1;
  ++request.level;
  become_realtime(request);
  const std::int64_t limit = to_nanoseconds(settings_.stall_limit);
  const std::int64_t pause = std::clamp<std::int64_t>(limit / 10, 100000, 10000000);
  while (running() && !stopping_.load(std::memory_order_acquire)) {
    sleep_until(steady_now() + pause);
    const std::int64_t last = heartbeat_.load(std::memory_order_acquire), silent = steady_now() - last;
    if (silent <= limit + period_ || !running()) continue;
    halt_devices();
    end("the loop stalled: " + std::to_string(silent / 1000000) + " ms without a tick", true);
    stopping_.store(true, std::memory_order_release);
  }
}

}  // namespace burrlab
