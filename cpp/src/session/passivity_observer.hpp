// The energy that a loop gives to a hand: what sampling creates.
#pragma once

#include "burrlab/types.hpp"

namespace burrlab {

/// A force is held between ticks, so the work of the last force over the displacement to this tick is exact,
/// as far as the device's positions are. Bone that is pressed or burred gives back at most what it took:
/// energy above zero was made by the sampling.
class PassivityObserver {
 public:
  /// Once a tick: the device's position [mm], and the force that it gets from now on [N].
  void update(const Vec3& position, const Vec3& force) noexcept {
    if (started_) {
      energy_ += force_.dot(position - position_);
      if (energy_ > most_) most_ = energy_;
    }
    position_ = position;
    force_ = force;
    started_ = true;
  }
  void set_force_zero() noexcept { force_.setZero(); }  ///< no force acts until the next update

  double energy() const { return energy_; }  ///< given to the hand minus taken from it [mJ]
  double most() const { return most_; }      ///< the largest `energy` so far, at least 0 [mJ]

 private:
  Vec3 position_ = Vec3::Zero(), force_ = Vec3::Zero();
  double energy_ = 0.0, most_ = 0.0;
  bool started_ = false;
};

}  // namespace burrlab
