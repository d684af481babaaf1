// A simulated hand with a simulated device, for tests, demonstrations and studies of stability.
#pragma once

#include "session/sent_force_device.hpp"

namespace burrlab {

/// Defaults are ours. A stroke is one full turn, out to +amplitude, back through -amplitude and home.
struct HandSettings {
  Vec3 start = Vec3(0.0, 0.0, 3.5);  ///< of the burr's centre, out of contact [mm]
  Vec3 into = Vec3(0.0, 0.0, -1.0);  ///< unit vector into the bone, of the push
  Vec3 along = Vec3(1.0, 0.0, 0.0);  ///< unit vector of the strokes, perpendicular to `into`
  double push = 1.0;                 ///< static force into the bone [N]
  double presses = 0.0;              ///< of size `push`, per second; 0: a steady push
  double amplitude = 8.0;            ///< of a stroke [mm]
  double strokes = 1.4;              ///< per second; 0: a still push
  double strokes_after = 1.0;        ///< start of the strokes; they grow over a second [s]
  double approach = 5.0;             ///< speed of the hand towards the bone [mm/s]
  double follow = 200.0;             ///< time constant of the hand's giving way [ms]
  double mass = 0.1;                 ///< of hand and device [kg]
  double damping = 5.0;              ///< of hand and device, b [N s/m]
  double grip = 0.4;                 ///< spring between the hand's target and the device [N/mm]
  double friction = 0.0;             ///< Coulomb friction of the device, against its motion [N]
  double encoder_step = 0.0;         ///< positions are read to the nearest multiple, by axis [mm]; 0: exactly
  bool on = true;                    ///< the burr turns
  double on_after = 0.0;             ///< not before this time [s]
};

/// A point mass with damping and friction. A spring draws it to the hand's target. Along `into` the target
/// moves, at most at `approach`, to where the spring pushes with `push`. Out of contact this is the approach;
/// at rest on bone the force is exactly `push`. The loop's force is held between readings. Deterministic.
///
/// Presses begin with the first force felt. The push rises for a quarter of a press, is held for three
/// tenths, falls for a quarter and is zero for the rest; rise and fall are x^2 (3 - 2x). The target follows
/// the change of the push at once, so giving way does not flatten a press.
class HandDevice : public SentForceDevice {
 public:
  static constexpr double longest_step = 0.02;  ///< of the integration [ms]

  explicit HandDevice(const HandSettings& settings);  ///< throws if a setting is out of range

  void start(double period) override;
  DeviceReading read(double time, std::uint64_t periods) noexcept override;
  bool simulated() const noexcept override { return true; }
  void write(const Vec3& force) noexcept override;
  std::string name() const override { return "simulated hand"; }
  DeviceModel model() const override {
    return {settings_.damping, settings_.encoder_step, settings_.friction};
  }

  const HandSettings& settings() const { return settings_; }

  // For tests, from the loop's thread or while it stands still.
  const Vec3& position() const { return position_; }  ///< true [mm]
  const Vec3& velocity() const { return velocity_; }  ///< true [mm/s]
  const Vec3& target() const { return target_; }      ///< of the hand [mm]

 private:
  void aim(double time) noexcept;
  double press(double time, double& push) noexcept;
  void advance(double time) noexcept;
  Vec3 reading() const noexcept;

  HandSettings settings_;
  double period_ = 1e-3, step_ = 0.0;  // of the loop, of the integration [s]
  int steps_ = 0;                      // a period
  double decay_ = 0.0, reach_ = 0.0;   // of a velocity over a step; of its way [s]
  double drift_ = 0.0;                 // way of a step per acceleration [s^2]
  double time_ = 0.0;                  // of the simulation [s]
  bool read_ = false;                  // `read` was called
  double depth_ = 0.0;                 // of the target along `into` [mm]
  double felt_ = -1.0;                 // time of the first force; negative before it [s]
  Vec3 position_, velocity_, target_, force_, last_reading_;
};

}  // namespace burrlab
