#include "effects/motion.hpp"

#include <algorithm>

#include "portable_math.hpp"

namespace burrlab {

constexpr int most_contacts = 4;   // in one interval
constexpr double short_of = 1e-6;  // distance of a stopped parcel from the voxel, over the least spacing

Motion::Interval Motion::interval(double seconds) const {
  Interval made;
  made.seconds = seconds;
  const double times[2] = {parameters_->dust_drag_time, parameters_->liquid_drag_time};
  for (int wet = 0; wet < 2; ++wet) {
    made.kept[wet] = portable::exp(-seconds / times[wet]);
    made.way[wet] = times[wet] * (1.0 - made.kept[wet]);
  }
  return made;
}

double Motion::friction(const Parcels& parcels, std::size_t i) const {
  if (parcels.dry(i)) return parameters_->dust_friction;
  const double dusty = double(parcels.mass[i][dust]) / double(parcels.total(i));
  return parameters_->liquid_friction + dusty * (parameters_->paste_friction - parameters_->liquid_friction);
}

bool Motion::rests(const Parcels& parcels, std::size_t i) const {
  if (parcels.support[i] < 0 || !field_->solid_number(parcels.support[i])) return false;
  const auto& sucker = *sucker_;
  if (!sucker) return true;
  const double distance = (sucker->position - parcels.position[i]).norm();
  if (distance > sucker->reach) return true;
  if (distance <= sucker->radius) return false;
  const double drag_time = parcels.dry(i) ? parameters_->dust_drag_time : parameters_->liquid_drag_time;
  const double held = friction(parcels, i) * parameters_->gravity * drag_time;  // by friction, on level bone
  return sucker->air(parcels.position[i]).squaredNorm() < held * held;
}

void Motion::advance(Parcels& parcels, std::size_t i, const Interval& interval) const {
  const int wet = parcels.dry(i) ? 0 : 1;
  const double drag_time = wet ? parameters_->liquid_drag_time : parameters_->dust_drag_time;
  Vec3& velocity = parcels.velocity[i];
  Vec3 at = parcels.position[i];
  // dv/dt = g - (v - air)/tau: towards `last` with the time constant tau.
  Vec3 last = (drag_time * parameters_->gravity) * down_;
  if (*sucker_) last += (*sucker_)->air(at);
  Vec3 left = interval.seconds * last + interval.way[wet] * (velocity - last);
  velocity = last + interval.kept[wet] * (velocity - last);

  const double gap = short_of * field_->least_spacing(), slow = parameters_->rest_speed;
  const Vec3 begin = at;
  parcels.support[i] = -1;
  LevelHit hit;
  std::int64_t first = -1;

  for (int contacts = 0; contacts < most_contacts; ++contacts) {
    if (!field_->first_hit(at, left, hit)) {
      if (!field_->solid(Vec3(at + left))) at += left;
      break;
    }
    const double part = std::max(0.0, hit.part - gap / left.norm());
    const Vec3 stop = at + part * left;
    if (!field_->solid(stop)) at = stop;
    left *= 1.0 - part;
    if (contacts == 0) {
      first = field_->number(hit.voxel);
      // The velocity follows the mean surface; faces of voxels only end ways.
      const Vec3 normal = field_->normal(hit);
      const double into = std::min(0.0, velocity.dot(normal));
      Vec3 along = velocity - into * normal;
      const double speed = along.norm();
      const double kept =
          speed > 0.0 ? std::max(0.0, 1.0 + friction(parcels, i) * into / speed) : 0.0;  // into <= 0
      along *= kept;
      velocity = along - parameters_->restitution * into * normal;
      left = kept * (left - std::min(0.0, left.dot(normal)) * normal);
    } else {
      left -= left.dot(hit.face) * hit.face;
    }
    if (left.squaredNorm() == 0.0) break;
  }
  parcels.position[i] = at;
  if (first < 0) return;
  const bool stuck = (at - begin).norm() < slow * interval.seconds;
  if (velocity.norm() >= slow && !stuck) return;
  velocity.setZero();
  parcels.support[i] = first;
}

}  // namespace burrlab
