// A burr on a bone: tick by tick, or held at a force.
//
//     burrlab::BurrContact contact(bone, burrlab::Burr(3.0), burrlab::paper_material("bone"), /*seed=*/1);
//     const burrlab::Contact now = contact.step({0, 0, 2.7}, /*dt=*/1.0, /*burr_on=*/true);  // [mm], [ms]
//     if (now.touching) device.send(now.force);                                             // [N]
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "burrlab/force.hpp"
#include "burrlab/material.hpp"
#include "burrlab/voxel_bone.hpp"

namespace burrlab {

struct ErosionSteps;
class Tick;
struct TickSums;

/// The contact of one tick. The force is that before the tick's erosion.
struct Contact {
  Vec3 force = Vec3::Zero();   ///< [N]
  double magnitude = 0.0;      ///< |F| before fading [N]
  Vec3 normal = Vec3::Zero();  ///< out of the bone
  double penetration = 0.0;    ///< h [mm]
  double c_e = 0.0;            ///< of Eq. 3; with tissues, the mean over the mass met [N/mm^2]
  double m0 = 0.0;             ///< [mm^3]
  Vec3 m1 = Vec3::Zero();      ///< [mm^4]
  double removed = 0.0;        ///< solid bone removed in the tick [mm^3]
  std::int64_t lost = 0;       ///< bone removed [levels]
  std::uint64_t tick = 0;      ///< its number
  bool touching = false;       ///< there is bone inside the sphere
  bool ambiguous = false;      ///< |m_1| < 0.1 m_0 R: the force fades
  bool coarse = false;         ///< R/s < 7.5
  bool faint = false;          ///< over 5 % of the mass is in voxels with p < 32, where `layer` errs
};

/// A descent under an exactly constant force, tick by tick.
struct HeldDescent {
  std::vector<double> position;  ///< along the axis from the start, before each tick's erosion [mm]
  std::vector<double> force;     ///< axial, at that position [N]
  std::vector<double> removed;   ///< in each tick [mm^3]
  std::int64_t ambiguous = 0;    ///< ticks whose contact has no direction
  std::int64_t faint = 0;        ///< ticks with over 5 % of the mass in voxels with p < 32
  bool reached = false;          ///< the burr came to the end of its travel
};

/// One thread at a time steps the burrs of a bone; a contact keeps its bone, which nobody may
/// assign to. A tick allocates nothing and waits for nothing; where dt differs from the last one's, it makes new
/// constants first.
class BURRLAB_API BurrContact {
 public:
  /// `index`: burrs on one bone have different ones, and so different random numbers. Throws InvalidArgument
  /// if the radius is below 4 voxels, or the bone has tissues of another material.
  BurrContact(std::shared_ptr<VoxelBone> bone, const Burr& burr, const Material& material, std::uint64_t seed,
              std::uint32_t index = 0, Scheme scheme = Scheme::layer);
  BurrContact(BurrContact&&) noexcept;
  ~BurrContact();

  /// The contact at `center` [mm], without erosion or a tick. The caller holds a VoxelBone::Reading.
  Contact probe(const Vec3& center) const;
  /// One tick of dt [ms] at `center` [mm]. `step`, `erode` and `hold` throw InvalidArgument if another thread
  /// uses the bone, a number is not finite or alpha dt is above 1000.
  Contact step(const Vec3& center, double dt, bool burr_on);
  /// One tick with the constants `steps` of this bone and material, or with the burr off if null. The caller
  /// holds a VoxelBone::Changing.
  Contact step(const Vec3& center, const ErosionSteps* steps);
  /// The erosion of a tick at `center` [mm]. Returns the solid bone removed [mm^3].
  double erode(const Vec3& center, double dt);

  /// At most `ticks` ticks of dt [ms]. Each is at the position start + s axis, s >= from, where the axial
  /// force is `force` [N]. Ends when s reaches `travel` [mm]. `axis` is a unit vector into the bone.
  /// `now_and_then` is called every 256 ticks and may throw.
  HeldDescent hold(double force, const Vec3& start, const Vec3& axis, double from, double travel, double dt,
                   std::int64_t ticks, const std::function<void()>& now_and_then = {});

  const ErosionSteps& steps_of(double dt);  ///< constants for dt [ms], valid until the next call

  const std::shared_ptr<VoxelBone>& bone() const { return bone_; }  ///< that it cuts
  const Burr& burr() const { return burr_; }                        ///< its radius
  const Material& material() const { return material_; }            ///< of a bone without tissues
  std::uint64_t seed() const { return seed_; }                      ///< of the random numbers
  std::uint32_t index() const { return index_; }                    ///< among the bone's burrs
  Scheme scheme() const { return scheme_; }                         ///< of the voxels

  std::uint64_t tick = 0;  ///< number of the next tick

 private:
  Contact to_contact(const Moments& moments, const TickSums& sums) const;
  std::int64_t erode_at_force(double force, const Vec3& center, const ErosionSteps& steps);
  void check_tissues() const;

  std::shared_ptr<VoxelBone> bone_;
  Burr burr_;
  Material material_;
  std::uint64_t seed_;
  std::uint32_t index_;
  Scheme scheme_;
  std::unique_ptr<const Tick> tick_;
  // The constants of the last dt [ms], and the tissues they belong to.
  double dt_ = 0.0;
  std::shared_ptr<const TissueMap> tissues_;
  std::unique_ptr<ErosionSteps> steps_;
};

}  // namespace burrlab
