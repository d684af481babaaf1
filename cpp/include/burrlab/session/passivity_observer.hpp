// The energy that a loop gives to a hand: what a spring of bone, felt in samples, creates out of nothing.
#pragma once

#include "burrlab/types.hpp"

namespace burrlab {

/// A force is held from one tick to the next, so the work of the force of the last tick over the displacement
/// up to this one is exact, as far as the device's positions are. Bone that is only pressed, or burred, gives
/// back at most what it took: above zero, the energy was made by the sampling.
class PassivityObserver {
 public:
  /// Once a tick: where the device is [mm], and the force it is sent from now on [N].
  void update(const Vec3& position, const Vec3& force) noexcept {
    if (started_) {
      energy_ += force_.dot(position - position_);
      if (energy_ > most_) most_ = energy_;
    }
    position_ = position;
    force_ = force;
    started_ = true;
  }
  void reset() noexcept { *this = {}; }

  double energy() const { return energy_; }  ///< given to the hand minus taken from it [mJ]
  double most() const { return most_; }      ///< the largest `energy` so far, at least 0 [mJ]

 private:
  Vec3 position_ = Vec3::Zero(), force_ = Vec3::Zero();
  double energy_ = 0.0, most_ = 0.0;
  bool started_ = false;
};

}  // namespace burrlab
