// The start of a loop, its ends, its watchdog and its ticks.
#include "burrlab/session/haptic_loop.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <exception>
#include <sstream>

#include "copy_under.hpp"
#include "quaternion.hpp"
#include "require.hpp"
#include "session/device_frame.hpp"
#include "session/force_guard.hpp"
#include "session/passivity_observer.hpp"
#include "session/realtime.hpp"
#include "session/virtual_coupling.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {
namespace {

std::int64_t to_nanoseconds(double milliseconds) { return std::llround(milliseconds * 1e6); }

std::size_t ring_size(const LoopSettings& settings, double period) {
  const double rate = 1e3 / period;
  if (!(rate <= 10000.0 * (1.0 + 1e-9))) refuse("rate", "at most 10000 Hz", rate);
  if (period > 1e6) refuse("period", "at most 1e6 ms", period);
  require_positive("ring", settings.ring);
  const double records = settings.ring * 1e3 / period;
  if (!(records <= 4e6)) refuse("records of the ring", "at most 4000000", records);
  return std::max<std::size_t>(std::size_t(records), 256);
}

void set(std::array<double, 3>& to, const Vec3& from) { to = {from[0], from[1], from[2]}; }

}  // namespace

HapticLoop::HapticLoop(std::shared_ptr<TickExecutor> executor, std::vector<std::shared_ptr<Device>> devices,
                       const LoopSettings& settings)
    : executor_(executor ? std::move(executor) : throw InvalidArgument("executor must not be null")),
      devices_(std::move(devices)),
      settings_(settings),
      period_(to_nanoseconds(executor_->setup().period)),
      first_tick_(executor_->tick()),
      ring_(std::make_shared<RecordRing>(ring_size(settings, executor_->setup().period))) {
  if (devices_.size() != executor_->burrs())
    refuse("number of devices", "one a burr, " + std::to_string(executor_->burrs()), double(devices_.size()));
  for (const auto& device : devices_)
    if (!device) throw InvalidArgument("device must be a Device, got None");
  require_positive("stall_limit", settings.stall_limit);
  if (settings.stall_limit > 1e9) refuse("stall_limit", "at most 1e9 ms", settings.stall_limit);
  if (settings.wall_clock && executor_->setup().period > 0.5 * settings.stall_limit)
    refuse("period", "at most half the limit of a stall on the wall clock", executor_->setup().period);
  record_.burrs = std::uint32_t(devices_.size());
  if (!(settings.stop_force > 0.0)) refuse("stop_force", "positive", settings.stop_force);
  const auto one_a_burr = [this](const char* what, std::size_t count) {
    if (count && count != devices_.size())
      refuse(std::string("number of ") + what, "one a burr, " + std::to_string(devices_.size()),
             double(count));
  };
  one_a_burr("guards", settings.guards.size());
  one_a_burr("models", settings.models.size());
  const double hold = settings.stall_limit + executor_->setup().period;
  for (std::size_t i = 0; i < devices_.size(); ++i)
    guards_.emplace_back(settings.guards.empty() ? settings.guard : settings.guards[i], hold);
  if (settings.coupling != 0.0) couplings_.assign(devices_.size(), VirtualCoupling(settings.coupling));
  one_a_burr("frames", settings.frames.size());
  for (const DeviceFrame& frame : settings.frames) frames_.emplace_back(frame);
  observers_.resize(devices_.size());
}

HapticLoop::~HapticLoop() { stop(); }

void HapticLoop::add_reader(std::shared_ptr<const RecordReader> reader) {
  if (started()) throw InvalidArgument("reader must be added before the loop is started");
  readers_.push_back(reader);
}

void HapticLoop::start() {
  const std::lock_guard<std::mutex> lock(life_mutex_);
  if (started()) throw InvalidArgument("loop must be started once: it has been");
  auto changing = std::make_unique<VoxelBone::Changing>(*executor_->bone());
  claim_devices();
  first_tick_ = executor_->tick();
  changing_ = std::move(changing);
  running_.store(true, std::memory_order_release);
  started_.store(true, std::memory_order_release);
  try {
    executor_->bone()->write_pages();
    for (const auto& device : devices_) ++begun_, device->start(1e-3 * executor_->setup().period);
    thread_ = std::thread([this] { run(); });
    while (heartbeat_.load(std::memory_order_acquire) == 0)
      std::this_thread::sleep_for(std::chrono::microseconds(100));
    if (settings_.wall_clock) watchdog_ = std::thread([this] { watch(); });
  } catch (...) {  // from a device, or a system that gives no thread
    std::string why = "a device threw";
    try {
      throw;
    } catch (const std::exception& error) {
      why = error.what();
    } catch (...) {
    }
    end("the loop could not be started: " + why, true);
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

/// Frees the devices for another loop, once no thread of this one can halt them.
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
    throw InvalidArgument("device " + std::to_string(i) +
                          " must serve one burr of one session at a time: it serves another");
  }
  claimed_ = true;
}

bool HapticLoop::wait(double seconds) {
  return wait_until(steady_after(seconds), std::chrono::milliseconds(5),
                    [this] { return started() && !running(); });
}

void HapticLoop::end(const std::string& reason, bool failed) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!reason_.empty()) return;  // the first reason counts
  reason_ = reason;
  failed_ = failed;
}

std::string HapticLoop::reason() const { return copy_under(mutex_, reason_); }
bool HapticLoop::failed() const { return copy_under(mutex_, failed_); }
std::vector<std::string> HapticLoop::realtime_notes() const { return copy_under(mutex_, notes_); }

LoopCounts HapticLoop::counts() const {
  constexpr auto relaxed = std::memory_order_relaxed;
  return {ticks_.load(relaxed), late_.load(relaxed), missed_.load(relaxed), dropped_.load(relaxed)};
}

EnergyGiven HapticLoop::energy(std::size_t burr) const {
  if (burr >= devices_.size()) refuse("burr", "below " + std::to_string(devices_.size()), double(burr));
  return {energy_[burr].load(std::memory_order_relaxed), most_energy_[burr].load(std::memory_order_relaxed)};
}

DeviceModel HapticLoop::model(std::size_t burr) const {
  if (burr >= devices_.size()) refuse("burr", "below " + std::to_string(devices_.size()), double(burr));
  DeviceModel model = devices_[burr]->model();
  if (settings_.models.empty()) return model;
  const DeviceModel& known = settings_.models[burr];
  if (std::isnan(model.damping)) model.damping = known.damping;
  if (std::isnan(model.encoder_step)) model.encoder_step = known.encoder_step;
  if (std::isnan(model.friction)) model.friction = known.friction;
  if (std::isnan(model.delay)) model.delay = known.delay;
  return model;
}

/// Ends the session where a hand must not feel its last force any longer.
bool HapticLoop::halt(const std::string& reason, bool failed) {
  halt_devices();
  end(reason, failed);
  return false;
}

void HapticLoop::halt_devices() noexcept {
  for (std::size_t i = 0; i < begun_; ++i) devices_[i]->halt();
}

/// Sets all to zero before stopping the first, which may take a while.
void HapticLoop::stop_devices() noexcept {
  for (std::size_t i = 0; i < begun_; ++i) devices_[i]->write(Vec3::Zero());
  halt_devices();
  for (std::size_t i = 0; i < begun_; ++i) devices_[i]->stop();
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
    halt("the loop stalled: " + std::to_string(silent / 1000000) + " ms without a tick");
    stopping_.store(true, std::memory_order_release);
  }
}

// The loop's own path: no lock, allocation or Python, here, in devices, the tick and the ring.

// Deadline n is n periods after the start. A tick stands for all deadlines since the last one.
void HapticLoop::run() {
  if (settings_.wall_clock) {
    std::vector<std::string> notes = become_realtime(settings_.realtime);
    if (settings_.message)
      for (const std::string& note : notes) settings_.message(note);
    const std::lock_guard<std::mutex> lock(mutex_);
    notes_ = std::move(notes);
  }
  const StandardArithmetic arithmetic;
  const std::int64_t start = steady_now(), stall = std::llround(settings_.stall_limit * 1e6);
  std::int64_t deadline = 0, last_start = start;
  heartbeat_.store(start, std::memory_order_release);
  while (!stopping_.load(std::memory_order_acquire)) {
    const std::uint64_t executed = ticks_.load(std::memory_order_relaxed);
    std::uint64_t periods = 1;
    double late = 0.0;  // [us]
    std::int64_t now = start + (deadline + 1) * period_;
    if (settings_.wall_clock) {
      sleep_until(now);
      now = steady_now();
      const std::int64_t due = (now - start) / period_;
      periods = std::uint64_t(due - deadline);
      if (now - last_start > stall) {
        halt("the loop stalled: " + std::to_string((now - last_start) / 1000000) + " ms without a tick");
        break;
      }
      if (executed > 0)
        jitter_.add(1e-3 * std::abs(double(now - last_start) - double(periods) * double(period_)));
      late = 1e-3 * double(now - start - due * period_);
      last_start = now;
    } else {
      wait_for_readers();
    }
    deadline += std::int64_t(periods);
    if (!tick(periods, 1e-9 * double(now - start))) break;
    if (settings_.wall_clock) {
      const std::int64_t done = steady_now();
      if (ticks_.load(std::memory_order_relaxed) > executed) {  // false until a device has given a position
        lateness_.add(late);
        wall_time_.add(1e-3 * double(done - now));
      }
      heartbeat_.store(done, std::memory_order_release);
    }
    if (settings_.ticks && ticks_.load(std::memory_order_relaxed) >= settings_.ticks) {
      end("all ticks were executed", false);
      break;
    }
  }
  stop_devices();
  if (settings_.wall_clock && settings_.realtime.lock_memory) unlock_memory();
  if (settings_.message) settings_.message(reason());
  changing_.reset();
  running_.store(false, std::memory_order_release);
}

// False if the session ends.
bool HapticLoop::read_device(std::size_t i, std::uint64_t periods, double time, bool& waiting) {
  using Status = DeviceReading::Status;
  DeviceReading reading = devices_[i]->read(time, periods);
  const auto who = [i] { return "device " + std::to_string(i); };
  if (reading.status == Status::finished) return end(who() + " has come to its end", false), false;
  if (reading.status == Status::lost) {
    halt_devices();
    const std::string why = devices_[i]->fault();
    const double age = std::isfinite(reading.age) ? std::min(reading.age, 1e9) : 1e9;
    const std::string old = "its last position is " + std::to_string(int(age)) + " ms old";
    return end(who() + " was lost: " + (why.empty() ? old : why), true), false;
  }
  if (reading.buttons & settings_.stop_buttons)
    return halt("a stop button of " + who() + " was pressed", false);
  waiting |= reading.status == Status::waiting;
  if (!frames_.empty() && reading.status == Status::ok) frames_[i].apply(reading);
  if (!reading.position.allFinite() || !reading.velocity.allFinite())
    return halt(who() + " gave a position or velocity that is not finite");
  if (!is_unit(reading.orientation))
    return halt(who() + " gave an orientation that is not a quaternion of length 1");
  BurrRecord& burr = record_.burr[i];
  set(burr.center, reading.position);
  set(burr.device_position, reading.position);
  set(burr.device_velocity, reading.velocity);
  burr.age = reading.age;
  burr.orientation = reading.orientation;
  burr.buttons = reading.buttons;
  burr.on = reading.on;
  return true;
}

// False if the session ends. A coupling moves the burr off the device.
bool HapticLoop::read_devices(std::uint64_t periods, double time, bool& waiting) {
  for (std::size_t i = 0; i < devices_.size(); ++i)
    if (!devices_[i]->simulated() && !read_device(i, periods, time, waiting)) return false;
  for (std::size_t i = 0; i < devices_.size() && !waiting; ++i)
    if (devices_[i]->simulated() && !read_device(i, periods, time - waited_, waiting)) return false;
  if (waiting || couplings_.empty()) return true;
  for (std::size_t i = 0; i < devices_.size(); ++i) {
    BurrRecord& burr = record_.burr[i];
    const Coupled coupled = couplings_[i].couple(*executor_, i, to_vector(burr.device_position));
    set(burr.center, coupled.center);
    wanted_[i] = coupled.force;
  }
  return true;
}

/// While one device waits, none pulls; then the ramps begin anew.
void HapticLoop::rest_devices() noexcept {
  for (std::size_t i = 0; i < devices_.size(); ++i) {
    devices_[i]->write(Vec3::Zero());
    guards_[i].reset();
    observers_[i].set_force_zero();
  }
}

/// dt [ms] is the time since the last forces. False if the session ends at once.
bool HapticLoop::send_forces(double dt) {
  for (std::size_t i = 0; i < devices_.size(); ++i) {
    BurrRecord& burr = record_.burr[i];
    if (couplings_.empty()) wanted_[i] = to_vector(burr.force);
    if (!frames_.empty() && frames_[i].held()) wanted_[i].setZero();
    if (!wanted_[i].allFinite() || !to_vector(burr.force).allFinite())
      return halt("the force of burr " + std::to_string(i) + " is not finite");
    if (stopper_ == most_burrs && wanted_[i].norm() >= settings_.stop_force) stopper_ = i;
  }
  for (std::size_t i = 0; i < devices_.size(); ++i) {
    BurrRecord& burr = record_.burr[i];
    const Vec3 sent = stopper_ == most_burrs ? guards_[i].apply(wanted_[i], dt) : Vec3(Vec3::Zero());
    devices_[i]->write(frames_.empty() ? sent : frames_[i].to_device(sent));
    set(burr.sent, sent);
    const double scale = frames_.empty() ? 1.0 : frames_[i].scale();
    observers_[i].update(to_vector(burr.device_position) / scale, sent);
    energy_[i].store(observers_[i].energy(), std::memory_order_relaxed);
    most_energy_[i].store(observers_[i].most(), std::memory_order_relaxed);
  }
  return true;
}

bool HapticLoop::tick(std::uint64_t periods, double time) {
  const std::int64_t cpu_start = thread_cpu_now();
  bool waiting = false;
  if (!read_devices(periods, time, waiting)) return false;
  if (waiting) {
    waited_ += 1e-9 * double(period_) * double(periods);
    if (ticks_.load(std::memory_order_relaxed) > 0) rest_devices();
    return true;
  }
  const auto k = std::uint32_t(std::min<std::uint64_t>(periods, most_periods));
  record_.index = executor_->tick();
  record_.k = k;
  record_.time = time;
  executor_->execute(record_);
  // Guards with a memory count all the time for which a force was held, also beyond k periods.
  const bool remembers =
      !settings_.guards.empty() || std::isfinite(settings_.guard.continuous) || settings_.guard.ramp > 0.0;
  const double since = remembers ? double(periods) : double(k);
  if (!send_forces(since * executor_->setup().period)) return false;
  record_.cpu_time = 1e-3 * double(thread_cpu_now() - cpu_start);
  ring_->push(record_);
  constexpr auto relaxed = std::memory_order_relaxed;
  tick_time_.add(record_.cpu_time);
  ticks_.store(ticks_.load(relaxed) + 1, relaxed);
  if (k > 1) late_.store(late_.load(relaxed) + 1, relaxed);
  missed_.store(missed_.load(relaxed) + periods - 1, relaxed);
  dropped_.store(dropped_.load(relaxed) + periods - k, relaxed);
  if (stopper_ == most_burrs) return true;
  std::ostringstream reason;
  reason << "the force of burr " << stopper_ << " reached " << settings_.stop_force << " N";
  return end(reason.str(), false), false;
}

// On a virtual clock nothing is lost because of a slow reader.
void HapticLoop::wait_for_readers() {
  const auto is_behind = [this](const std::weak_ptr<const RecordReader>& weak) {
    const auto reader = weak.lock();  // an abandoned reader will never read
    return reader && reader->behind() + 1 >= ring_->capacity() / 2;
  };
  for (const auto& reader : readers_)
    while (is_behind(reader) && !stopping_.load(std::memory_order_acquire))
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

}  // namespace burrlab
