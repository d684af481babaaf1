#include "session/hand_device.hpp"

#include <algorithm>
#include <cmath>

#include "require.hpp"

namespace burrlab {

// Parts of a press's time: end of the rise, end of the height, end of the fall.
constexpr double press_up = 0.25, press_down = 0.55, press_over = 0.8;

static double ease_in(double x) { return x * x * (3.0 - 2.0 * x); }

static HandSettings checked(const HandSettings& s) {
  require_finite("start", s.start);
  const auto require_unit = [](const char* name, const Vec3& v) {
    if (!(std::abs(v.norm() - 1.0) < 1e-9)) refuse(std::string("length of ") + name, "1", v.norm());
  };
  require_unit("into", s.into);
  require_unit("along", s.along);
  if (!(std::abs(s.into.dot(s.along)) < 1e-9))
    refuse("cosine between into and along", "0", s.into.dot(s.along));
  require_not_negative("push", s.push);
  require_not_negative("presses", s.presses);
  require_not_negative("amplitude", s.amplitude);
  require_not_negative("strokes", s.strokes);
  require_not_negative("strokes_after", s.strokes_after);
  require_positive("approach", s.approach);
  require_positive("follow", s.follow);
  require_positive("mass", s.mass);
  require_not_negative("damping", s.damping);
  require_positive("grip", s.grip);
  require_not_negative("friction", s.friction);
  require_not_negative("encoder_step", s.encoder_step);
  require_not_negative("on_after", s.on_after);
  return s;
}

HandDevice::HandDevice(const HandSettings& settings)
    : settings_(checked(settings)), position_(settings.start) {
  start(1e-3);
}

void HandDevice::start(double period) {
  require_positive("period", period);
  period_ = period;
  steps_ = int(std::ceil(period / (1e-3 * longest_step) - 1e-9));
  step_ = period / steps_;
  // A velocity decays exactly over a step, whatever the damping.
  const double rate = settings_.damping / settings_.mass;  // [1/s]
  decay_ = std::exp(-rate * step_);
  reach_ = rate > 0.0 ? -std::expm1(-rate * step_) / rate : step_;
  drift_ = rate * step_ > 1e-4 ? (step_ - reach_) / rate : 0.5 * step_ * step_ * (1.0 - rate * step_ / 3.0);
  position_ = target_ = settings_.start;
  velocity_.setZero();
  force_.setZero();
  time_ = depth_ = 0.0;
  felt_ = -1.0;
  read_ = false;
  last_reading_ = reading();
  resume();
}

// Sets the push at this time [N]; returns its change [N/s]. Before the first contact it is the whole push,
// which moves the hand towards the bone.
double HandDevice::press(double time, double& push) noexcept {
  const HandSettings& s = settings_;
  push = s.push;
  if (felt_ < 0.0) {
    if (force_.isZero(0.0)) return 0.0;
    felt_ = time;
  }
  const double turns = s.presses * (time - felt_), part = turns - std::floor(turns);
  const bool rises = part < press_up;
  if (part >= press_up && part < press_down) return 0.0;
  if (part >= press_over) {
    push = 0.0;
    return 0.0;
  }
  const double width = rises ? press_up : press_over - press_down;
  const double x = rises ? part / width : (press_over - part) / width;
  push = s.push * ease_in(x);
  return (rises ? 1.0 : -1.0) * s.push * 6.0 * x * (1.0 - x) * s.presses / width;
}

void HandDevice::aim(double time) noexcept {
  const HandSettings& s = settings_;
  const double here = (position_ - s.start).dot(s.into);
  double push = s.push;
  if (s.presses > 0.0) depth_ += step_ * press(time, push) / s.grip;
  const double wanted = (here + push / s.grip - depth_) / (1e-3 * s.follow);
  depth_ += step_ * std::clamp(wanted, -s.approach, s.approach);
  const double since = time - s.strokes_after;
  const double grown = std::clamp(since, 0.0, 1.0), ease = ease_in(grown);
  const double swing = since > 0.0 ? ease * s.amplitude * std::sin(2.0 * pi * s.strokes * since) : 0.0;
  target_ = s.start + depth_ * s.into + swing * s.along;
}

// One step: the spring at the middle of its way, friction of constant size against the motion. A motion that
// friction stops within the step stays at rest while the drive is no larger than the friction.
void HandDevice::advance(double time) noexcept {
  const HandSettings& s = settings_;
  aim(time);
  const Vec3 drive = force_ + s.grip * (target_ - position_ - (0.5 * step_) * velocity_);
  const double speed = velocity_.norm(), strength = drive.norm();
  Vec3 resistance = Vec3::Zero();
  if (s.friction > 0.0) {
    if (speed > 0.0) {
      resistance = (s.friction / speed) * velocity_;
    } else if (strength <= s.friction) {
      return;
    } else {
      resistance = (s.friction / strength) * drive;
    }
  }
  const Vec3 acceleration = (drive - resistance) * (1e3 / s.mass);  // N/kg is 1000 mm/s^2
  const Vec3 next = decay_ * velocity_ + reach_ * acceleration;
  if (s.friction > 0.0 && speed > 0.0 && next.dot(velocity_) <= 0.0) {
    // At rest after this part of the step, at half the speed on average.
    const double part = speed / (speed - next.dot(velocity_) / speed);
    position_ += (0.5 * part * step_) * velocity_;
    velocity_.setZero();
    return;
  }
  position_ += reach_ * velocity_ + drift_ * acceleration;
  velocity_ = next;
}

Vec3 HandDevice::reading() const noexcept {
  const double step = settings_.encoder_step;
  if (step <= 0.0) return position_;
  return {step * std::round(position_[0] / step), step * std::round(position_[1] / step),
          step * std::round(position_[2] / step)};
}

DeviceReading HandDevice::read(double, std::uint64_t periods) noexcept {
  DeviceReading now;
  double elapsed = 0.0;
  if (halted()) force_.setZero();
  if (read_) {
    const auto steps = std::int64_t(std::min<std::uint64_t>(periods, 1000)) * steps_;
    for (std::int64_t i = 0; i < steps; ++i) advance(time_ + double(i) * step_);
    elapsed = double(steps) * step_;
    time_ += elapsed;
  }
  read_ = true;
  now.position = reading();
  if (elapsed > 0.0) now.velocity = (now.position - last_reading_) / elapsed;
  last_reading_ = now.position;
  now.on = settings_.on && time_ >= settings_.on_after - 0.5 * step_;
  return now;
}

void HandDevice::write(const Vec3& force) noexcept {
  force_ = halted() ? Vec3(Vec3::Zero()) : force;
  SentForceDevice::write(force_);
}

}  // namespace burrlab
