#include "effects/instruments.hpp"

#include <Eigen/Geometry>
#include <algorithm>

#include "require.hpp"

namespace burrlab {

static void require_direction(const char* name, const Vec3& v) {
  require_finite(name, v);
  require_positive(std::string("length of ") + name, v.norm());
}

void Nozzle::check() const {
  require_finite("position of the nozzle", position);
  require_direction("direction of the nozzle", direction);
  require_not_negative("rate of the nozzle", rate);
  if (rate > 1e6) refuse("rate of the nozzle", "at most 1e6 mm^3/s", rate);
  require_not_negative("speed of the nozzle", speed);
  if (speed > 1e6) refuse("speed of the nozzle", "at most 1e6 mm/s", speed);
}

void Sucker::check() const {
  require_finite("position of the sucker", position);
  require_positive("radius of the sucker", radius);
  require_finite("reach of the sucker", reach);
  if (reach < radius) refuse("reach of the sucker", "at least its radius", reach);
  require_not_negative("rate of the sucker", rate);
  require_not_negative("pull of the sucker", pull);
}

Vec3 Sucker::air(const Vec3& place) const {
  const Vec3 way = position - place;
  const double distance = way.norm();
  if (distance > reach || distance == 0.0) return Vec3::Zero();
  const double near = radius / std::max(distance, radius);
  return way * (pull * near * near / std::max(distance, radius));
}

void Camera::check() const {
  require_finite("position of the camera", position);
  require_finite("look_at of the camera", look_at);
  require_direction("up of the camera", up);
  const Vec3 view = look_at - position;
  if (!(view.norm() > 0.0)) refuse("distance of look_at from the camera", "positive", view.norm());
  const double sine = view.normalized().cross(up.normalized()).norm();
  if (sine < 1e-6) refuse("sine of the angle between up and the view", "above 1e-6", sine);
  if (!(view_angle >= 1.0 && view_angle <= 170.0)) refuse("view_angle", "from 1 to 170 degrees", view_angle);
  require_positive("aspect of the camera", aspect);
}

}  // namespace burrlab
