// A spring between device and burr: however stiff the contact, the hand meets no more than the spring.
#pragma once

#include "burrlab/session/tick_executor.hpp"

namespace burrlab {

/// Where the coupling leaves a burr, and what the hand feels.
struct Coupled {
  Vec3 center = Vec3::Zero();  ///< of the burr, x_b [mm]
  Vec3 force = Vec3::Zero();   ///< on the hand, k_c (x_b - x_d) [N]
  double residual = 0.0;       ///< |k_c (x_d - x_b) + F(x_b)|: what the balance misses [N]
  int probes = 0;
};

/// The burr has no mass: its centre x_b is where k_c (x_d - x_b) + F(x_b) = 0, F the model's force. Found
/// anew each tick, from the last offset x_b - x_d, by at most four probes of the bone; in free space x_b =
/// x_d.
class VirtualCoupling {
 public:
  static constexpr int most_probes = 4;
  static constexpr double tolerance = 1e-4;  ///< of the balance, below which no probe is added [N]

  explicit VirtualCoupling(double stiffness);  ///< k_c [N/mm]

  /// For a device at `device` [mm], now. No allocation, lock or exception; a place that is not finite is
  /// handed back without a force.
  Coupled couple(const TickExecutor& executor, std::size_t burr, const Vec3& device) noexcept;
  void reset() noexcept;  ///< forgets the last contact

  double stiffness() const { return stiffness_; }  ///< k_c [N/mm]

 private:
  double stiffness_;
  Vec3 offset_ = Vec3::Zero();  // x_b - x_d at the last tick
  double contact_ = 0.0;        // stiffness of the contact along the last step [N/mm]
};

}  // namespace burrlab
