// The loop's own path has no lock, allocation or Python in it: devices, the tick and the ring keep to that
// too.
#include <algorithm>
#include <chrono>
#include <cmath>

#include "burrlab/session/haptic_loop.hpp"

namespace burrlab {
namespace {

bool finite(const Vec3& v) { return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]); }

Vec3 to_vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

void set(std::array<double, 3>& to, const Vec3& from) { to = {from[0], from[1], from[2]}; }

}  // namespace

// Deadline n lies n periods after the start. A tick stands for all deadlines since the last one.
void HapticLoop::run() {
  if (settings_.wall_clock) {
    std::vector<std::string> notes = become_realtime(settings_.realtime);
    const std::lock_guard<std::mutex> lock(mutex_);
    notes_ = std::move(notes);
  }
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
        halt_devices();
        end("the loop stalled: " + std::to_string((now - last_start) / 1000000) + " ms without a tick", true);
        break;
      }
      if (executed > 0)
        jitter_.add(1e-3 * std::abs(double(now - last_start) - double(periods) * double(period_)));
      late = 1e-3 * double(now - start - due * period_);
      last_start = now;
    } else {
      make_room();
    }
    deadline += std::int64_t(periods);
    if (!tick(periods, 1e-9 * double(now - start))) break;
    if (settings_.wall_clock) {
      const std::int64_t done = steady_now();
      if (ticks_.load(std::memory_order_relaxed) > executed) {  // not while a device has given no position
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
  changing_.reset();
  running_.store(false, std::memory_order_release);
}

// False where the session ends. A coupling moves the burr off the device.
bool HapticLoop::read_devices(std::uint64_t periods, double time, bool& waiting) {
  using Status = DeviceReading::Status;
  for (std::size_t i = 0; i < devices_.size(); ++i) {
    const DeviceReading reading = devices_[i]->read(time, periods);
    const auto who = [i] { return "device " + std::to_string(i); };
    if (reading.status == Status::finished) return end(who() + " has come to its end", false), false;
    if (reading.status == Status::lost) {
      halt_devices();
      end(who() + " was lost: its last position is " + std::to_string(int(reading.age)) + " ms old", true);
      return false;
    }
    waiting |= reading.status == Status::waiting;
    if (!finite(reading.position) || !finite(reading.velocity)) {
      halt_devices();
      return end(who() + " gave a position or velocity that is not finite", true), false;
    }
    BurrRecord& burr = record_.burr[i];
    set(burr.center, reading.position);
    set(burr.device_position, reading.position);
    set(burr.device_velocity, reading.velocity);
    burr.age = reading.age;
    burr.on = reading.on;
  }
  if (waiting || couplings_.empty()) return true;
  for (std::size_t i = 0; i < devices_.size(); ++i) {
    BurrRecord& burr = record_.burr[i];
    const Coupled coupled = couplings_[i].couple(*executor_, i, to_vector(burr.device_position));
    set(burr.center, coupled.center);
    wanted_[i] = coupled.force;
  }
  return true;
}

bool HapticLoop::send_forces() {
  for (std::size_t i = 0; i < devices_.size(); ++i) {
    BurrRecord& burr = record_.burr[i];
    if (couplings_.empty()) wanted_[i] = to_vector(burr.force);
    if (!finite(wanted_[i]) || !finite(to_vector(burr.force))) {
      halt_devices();
      return end("the force of burr " + std::to_string(i) + " is not finite", true), false;
    }
    const Vec3 sent = guards_[i].apply(wanted_[i], record_.k * executor_->setup().period);
    devices_[i]->write(sent);
    set(burr.sent, sent);
    observers_[i].update(to_vector(burr.device_position), sent);
    energy_[i].store(observers_[i].energy(), std::memory_order_relaxed);
    most_energy_[i].store(observers_[i].most(), std::memory_order_relaxed);
  }
  return true;
}

bool HapticLoop::tick(std::uint64_t periods, double time) {
  const std::int64_t cpu_start = thread_cpu_now();
  bool waiting = false;
  if (!read_devices(periods, time, waiting)) return false;
  if (waiting) return true;
  const auto k = std::uint32_t(std::min<std::uint64_t>(periods, most_periods));
  record_.index = executor_->tick();
  record_.k = k;
  record_.time = time;
  executor_->execute(record_);
  if (!send_forces()) return false;
  record_.cpu_time = 1e-3 * double(thread_cpu_now() - cpu_start);
  ring_->push(record_);
  constexpr auto relaxed = std::memory_order_relaxed;
  tick_time_.add(record_.cpu_time);
  ticks_.store(ticks_.load(relaxed) + 1, relaxed);
  if (k > 1) late_.store(late_.load(relaxed) + 1, relaxed);
  missed_.store(missed_.load(relaxed) + periods - 1, relaxed);
  dropped_.store(dropped_.load(relaxed) + periods - k, relaxed);
  return true;
}

// On a virtual clock nothing is lost because a reader is slow.
void HapticLoop::make_room() {
  const auto is_behind = [this](const std::weak_ptr<const RecordReader>& weak) {
    const auto reader = weak.lock();  // one that nobody holds any more will never read
    return reader && reader->behind() + 1 >= ring_->capacity() / 2;
  };
  for (const auto& reader : readers_)
    while (is_behind(reader) && !stopping_.load(std::memory_order_acquire))
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

}  // namespace burrlab
