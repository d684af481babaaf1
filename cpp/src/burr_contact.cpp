#include "burrlab/burr_contact.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "erosion_steps.hpp"
#include "portable_math.hpp"
#include "require.hpp"
#include "standard_arithmetic.hpp"
#include "tick.hpp"

namespace burrlab {

static std::shared_ptr<VoxelBone> not_null(std::shared_ptr<VoxelBone> bone) {
  if (!bone) throw InvalidArgument("bone must be a VoxelBone, got None");
  return bone;
}

BurrContact::BurrContact(std::shared_ptr<VoxelBone> bone, const Burr& burr, const Material& material,
                         std::uint64_t seed, std::uint32_t index, Scheme scheme)
    : bone_(not_null(std::move(bone))),
      burr_(burr),
      material_(material),
      seed_(seed),
      index_(index),
      scheme_(scheme),
      tick_(std::make_unique<Tick>(*bone_, burr.radius, scheme, material.shape, seed, index)),
      steps_(std::make_unique<ErosionSteps>(0.0)) {
  check_tissues();
}

BurrContact::BurrContact(BurrContact&&) noexcept = default;
BurrContact::~BurrContact() = default;

// A sum of K M must fit in 63 bits, and a bone's tissues have one material.
void BurrContact::check_tissues() const {
  check_material(*bone_, material_);
  if (!bone_->tissues()) return;
  const Vec3 reach = burr_.radius * bone_->spacing().cwiseInverse() + Vec3::Ones();
  const double most = 4.18879020478639098 * reach.prod() * 65280.0;
  if (!(most * bone_->tissues()->table().largest_stiffness() < 0x1p63))
    refuse("radius over the voxel", "small enough for c_e of the tissues (200 at 1000 N/mm^2)",
           tick_->resolution());
}

// Makes new constants if dt differs from the last one, or the bone has other tissues.
const ErosionSteps& BurrContact::steps_of(double dt) {
  if (dt == dt_ && tissues_ == bone_->tissues()) return *steps_;
  const StandardArithmetic arithmetic;
  check_tissues();
  *steps_ = ErosionSteps(*bone_, material_, dt);
  tissues_ = bone_->tissues();
  dt_ = dt;
  return *steps_;
}

Contact BurrContact::to_contact(const Moments& moments, const TickSums& sums) const {
  Contact contact;
  contact.c_e = material_.c_e;
  if (bone_->tissues() && sums.mass > 0) {
    const std::int64_t whole = sums.stiffness / sums.mass, rest = sums.stiffness % sums.mass;
    contact.c_e = (double(whole) + double(rest) / double(sums.mass)) / Tissues::quanta;
  }
  const ElasticForce elastic = force_of(moments, burr_.radius, contact.c_e, material_.force_exponent);
  contact.force = elastic.force;
  contact.magnitude = elastic.magnitude;
  contact.normal = elastic.normal;
  contact.penetration = elastic.penetration;
  contact.m0 = moments.m0;
  contact.m1 = moments.m1;
  contact.removed = bone_->volume_of(sums.lost);
  contact.lost = sums.lost;
  contact.tick = tick;
  contact.touching = sums.mass > 0;
  contact.ambiguous = elastic.ambiguous;
  contact.coarse = tick_->resolution() < Tick::coarse;
  contact.faint = scheme_ == Scheme::layer && sums.faint * 20 > sums.mass;
  return contact;
}

Contact BurrContact::probe(const Vec3& center) const {
  const StandardArithmetic arithmetic;
  TickSums sums;
  const Moments moments = tick_->moments(*bone_, center, &sums);
  return to_contact(moments, sums);
}

Contact BurrContact::step(const Vec3& center, double dt, bool burr_on) {
  require_positive("dt", dt);
  const VoxelBone::Changing changing(*bone_);
  return step(center, burr_on ? &steps_of(dt) : nullptr);
}

// The erosion of a tick where |F| is `force`: alpha (|F|/1 N)^m of Eq. 4. Returns the levels removed.
std::int64_t BurrContact::erode_at_force(double force, const Vec3& center, const ErosionSteps& steps) {
  const double m = material_.rate_exponent;
  TickSums sums;
  if (m == 0.0) {
    sums = tick_->erode(*bone_, center, steps, tick);
  } else if (force > 0.0) {
    const double factor = std::min(portable::power(force, m), std::numeric_limits<double>::max());
    sums = tick_->erode(*bone_, center, steps.times(factor), tick);
  }
  ++tick;
  return sums.lost;
}

Contact BurrContact::step(const Vec3& center, const ErosionSteps* steps) {
  const StandardArithmetic arithmetic;
  if (steps && material_.rate_exponent != 0.0) {  // the rate needs the force first
    Contact contact = probe(center);
    contact.lost = erode_at_force(contact.magnitude, center, *steps);
    contact.removed = bone_->volume_of(contact.lost);
    return contact;
  }
  TickSums sums;
  const Moments moments = steps ? tick_->moments_and_erode(*bone_, center, *steps, tick, &sums)
                                : tick_->moments(*bone_, center, &sums);
  const Contact contact = to_contact(moments, sums);
  ++tick;
  return contact;
}

double BurrContact::erode(const Vec3& center, double dt) {
  const StandardArithmetic arithmetic;
  require_positive("dt", dt);
  const VoxelBone::Changing changing(*bone_);
  const double force = material_.rate_exponent == 0.0 ? 0.0 : probe(center).magnitude;
  return bone_->volume_of(erode_at_force(force, center, steps_of(dt)));
}

HeldDescent BurrContact::hold(double force, const Vec3& start, const Vec3& axis, double from, double travel,
                              double dt, std::int64_t ticks, const std::function<void()>& now_and_then) {
  const StandardArithmetic arithmetic;
  require_positive("force", force);
  require_positive("dt", dt);
  require_finite("from", from);
  require_finite("travel", travel);
  if (!(std::abs(axis.norm() - 1.0) < 1e-9)) refuse("length of axis", "1", axis.norm());
  const double tolerance = 1e-5 * force;                     // far below the noise of erosion
  const double finest = 1e-6 * bone_->spacing().minCoeff();  // positions are multiples of 2^-20 voxel
  const double coarsest_step = 0.25 * bone_->spacing().minCoeff();
  Contact contact;
  const auto axial = [&](double s) {
    contact = probe(start + s * axis);
    return -contact.force.dot(axis);
  };

  HeldDescent descent;
  double s = from, last_advance = finest;
  for (std::int64_t i = 0; i < ticks; ++i) {
    if (now_and_then && i % 256 == 255) now_and_then();
    const VoxelBone::Changing changing(*bone_);
    // Bracket [low, high] of the position: the force is below the set-point at low, above it at high.
    double low = s, low_force = axial(low), high = 0.0, high_force = 0.0;
    double step = std::max(1.5 * last_advance, finest);
    if (!(low_force >= force - tolerance)) {
      for (;;) {
        high = std::min(low + step, travel);
        high_force = axial(high);
        if (high_force >= force) break;
        low = high;
        low_force = high_force;
        if (low >= travel) {
          descent.reached = true;
          return descent;
        }
        step = std::min(2.0 * step, coarsest_step);
      }
      // False position with halving (Illinois): stays in the bracket, superlinear on a smooth force.
      double weight_low = low_force - force, weight_high = high_force - force;
      int side = 0;
      for (int iteration = 0; iteration < 60; ++iteration) {
        s = weight_high > weight_low ? (low * weight_high - high * weight_low) / (weight_high - weight_low)
                                     : 0.5 * (low + high);
        const double error = axial(s) - force;
        if (std::abs(error) <= tolerance || high - low <= finest) break;
        if (error < 0.0) {
          low = s;
          weight_low = error;
          if (side == -1) weight_high *= 0.5;
          side = -1;
        } else {
          high = s;
          weight_high = error;
          if (side == 1) weight_low *= 0.5;
          side = 1;
        }
      }
    }
    if (s >= travel) {
      descent.reached = true;
      return descent;
    }
    const std::int64_t lost =
        erode_at_force(contact.magnitude, start + s * axis, steps_of(dt));  // s was probed last
    if (!descent.position.empty()) last_advance = std::max(s - descent.position.back(), 0.5 * last_advance);
    descent.position.push_back(s);
    descent.force.push_back(-contact.force.dot(axis));
    descent.removed.push_back(bone_->volume_of(lost));
    descent.ambiguous += contact.ambiguous;
    descent.faint += contact.faint;
  }
  return descent;
}

}  // namespace burrlab
