// A burr in another program's loop: in its units, its frame and its time steps.
//
//     burrlab::HostBurr burr(bone, burrlab::Burr(3.0), burrlab::paper_material("bone"), {});
//     // each step of the host: positions in metres, dt in ms
//     const burrlab::HostForce feel = burr.step(tip, 1.0, drill_turns, handle);
//     body.add_force(feel.force);    // [N]
//     body.add_torque(feel.torque);  // about `handle` [N m]
//     if (feel.refused) log(feel.refused);
#pragma once

#include <array>

#include "burrlab/burr_contact.hpp"

namespace burrlab {

/// What a host sets once.
struct HostSettings {
  /// Rows of (A | t): a position in the bone [mm] is A times the host's plus t. A is a rotation or a mirror
  /// image of one (a left-handed host), times the scale. The default: a host in metres, in the bone's axes.
  std::array<double, 12> to_bone{1000, 0, 0, 0, 0, 1000, 0, 0, 0, 0, 1000, 0};
  double longest_tick = 1.0;      ///< a longer step of the host becomes several ticks of equal length [ms]
  std::uint64_t seed = 0;         ///< of the random numbers
  std::uint32_t index = 0;        ///< of this burr: burrs on one bone have different ones
  Scheme scheme = Scheme::layer;  ///< of the voxels
};

/// What a host feels of one step.
struct HostForce {
  Vec3 force = Vec3::Zero();      ///< on the burr, at the step's end, before its last tick's erosion [N]
  Vec3 torque = Vec3::Zero();     ///< about the reference point, (centre - reference) x F [N host length]
  double removed = 0.0;           ///< solid bone removed in the step [mm^3]
  int ticks = 0;                  ///< that the step was cut into
  const char* refused = nullptr;  ///< why nothing was done, valid until the next step; null if it was done
};

/// One thread at a time steps the burrs of a bone. Burrs step in the order of the calls: the first one meets
/// the bone that the second has not touched yet. A step that is done allocates nothing.
class BURRLAB_API HostBurr {
 public:
  static constexpr double longest_step = 1000.0;  ///< of the host [ms]

  /// Throws InvalidArgument if the burr does not fit the bone, or a setting is impossible.
  HostBurr(std::shared_ptr<VoxelBone> bone, const Burr& burr, const Material& material,
           const HostSettings& settings);

  /// The burr moves in a straight line from where the last step ended to `center` [host length], in dt [ms]
  /// in (0, 1000], which may differ from call to call. A burr that is not `on` feels and does not cut.
  /// Refused, at zero force, if a number is not finite, alpha dt of a tick is above 1000, or another thread
  /// uses the bone.
  HostForce step(const Vec3& center, double dt, bool on, const Vec3& reference = Vec3::Zero()) noexcept;
  /// Forgets where the last step ended: the next one begins at its own end.
  void lift() { lifted_ = true; }

  Vec3 to_bone(const Vec3& position) const;          ///< [host length] to [mm]
  Vec3 to_host(const Vec3& position) const;          ///< [mm] to [host length]
  Vec3 turned_to_host(const Vec3& direction) const;  ///< without scale, as a force

  BurrContact& contact() { return contact_; }    ///< in the bone's units; its `tick` is the next one's number
  const Contact& last() const { return last_; }  ///< of the last tick, in the bone's units
  const HostSettings& settings() const { return settings_; }  ///< as they were set

 private:
  BurrContact contact_;
  HostSettings settings_;
  double scale_;  // [mm] a unit of the host
  bool lifted_ = true;
  Vec3 center_ = Vec3::Zero();  // of the last step's end, in the bone [mm]
  Contact last_;
  std::string refused_;
};

}  // namespace burrlab
