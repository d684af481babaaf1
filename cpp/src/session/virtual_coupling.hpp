// A spring between device and burr. The hand meets at most its stiffness, however stiff the contact.
#pragma once

#include "burrlab/session/tick_executor.hpp"

namespace burrlab {

/// The burr's place in a coupling, and the force on the hand.
struct Coupled {
  Vec3 center = Vec3::Zero();  ///< of the burr, x_b [mm]
  Vec3 force = Vec3::Zero();   ///< on the hand, k_c (x_b - x_d) [N]
  double residual = 0.0;       ///< |k_c (x_d - x_b) + F(x_b)|, the error of the balance [N]
  int probes = 0;
};

/// The burr has no mass: its centre x_b is where k_c (x_d - x_b) + F(x_b) = 0, with the model's force F. Each
/// tick finds x_b from the last offset x_b - x_d with at most four probes. In free space x_b = x_d.
class VirtualCoupling {
 public:
  static constexpr int most_probes = 4;
  static constexpr double tolerance = 1e-4;  ///< of the balance; no probe is added below it [N]

  explicit VirtualCoupling(double stiffness);  ///< k_c [N/mm]

  /// The balance for a device at `device` [mm]. No allocation, lock or exception. A place that is not finite
  /// is returned without a force.
  Coupled couple(const TickExecutor& executor, std::size_t burr, const Vec3& device) noexcept;
  void reset() noexcept;  ///< forgets the last contact

  double stiffness() const { return stiffness_; }  ///< k_c [N/mm]

 private:
  double stiffness_;
  Vec3 offset_ = Vec3::Zero();  // x_b - x_d at the last tick
  double contact_ = 0.0;        // stiffness of the contact along the last step [N/mm]
};

}  // namespace burrlab
