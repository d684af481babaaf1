#include "effects/hidden_fraction.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "require.hpp"

namespace burrlab {
namespace {

constexpr int frame_side = 64;  // samples along an edge of the disc's frame

// Camera coordinates: right, up, forward.
struct Eye {
  Vec3 position, right, up, forward;
  explicit Eye(const Camera& camera) : position(camera.position) {
    forward = (camera.look_at - camera.position).normalized();
    right = forward.cross(camera.up).normalized();
    up = right.cross(forward);
  }
  Vec3 to(const Vec3& place) const {
    const Vec3 way = place - position;
    return {way.dot(right), way.dot(up), way.dot(forward)};
  }
};

// Slopes between which a circle at (across, ahead), ahead > radius, is seen.
std::array<double, 2> slopes(double across, double ahead, double radius) {
  const double middle = std::atan2(across, ahead),
               half = std::asin(radius / std::sqrt(across * across + ahead * ahead));
  constexpr double widest = 1.5;
  return {std::tan(std::max(-widest, middle - half)), std::tan(std::min(widest, middle + half))};
}

// The first sample with its middle behind a place in the frame [samples].
int first_sample(double place) { return int(std::clamp(std::ceil(place - 0.5), 0.0, double(frame_side))); }

double opacity(const Quanta& mass, const EffectParameters& parameters) {
  const double bulk = parameters.dust_bulking * double(mass[dust]),
               volume = bulk + double(mass[blood] + mass[water]);
  return (bulk * parameters.dust_opacity + double(mass[blood]) * parameters.blood_opacity +
          double(mass[water]) * parameters.water_opacity) /
         volume;
}

}  // namespace

double hidden_fraction(const Parcels& parcels, double quantum, const EffectParameters& parameters,
                       const Camera& camera, const BurrAt& burr) {
  camera.check();
  const Eye eye(camera);
  const Vec3 center = eye.to(burr.center);
  const double distance = center.norm();
  if (distance <= burr.radius) refuse("distance of the camera from the burr", "above its radius", distance);
  constexpr double nowhere = std::numeric_limits<double>::quiet_NaN();
  if (center[2] <= burr.radius) return nowhere;

  const double height = std::tan(0.5 * camera.view_angle * (3.14159265358979323846 / 180.0));
  const double width = height * camera.aspect;
  auto across = slopes(center[0], center[2], burr.radius), along = slopes(center[1], center[2], burr.radius);
  across = {std::max(across[0], -width), std::min(across[1], width)};
  along = {std::max(along[0], -height), std::min(along[1], height)};
  if (across[0] >= across[1] || along[0] >= along[1]) return nowhere;
  const double dx = (across[1] - across[0]) / frame_side, dy = (along[1] - along[0]) / frame_side;

  // The light that passes at each sample, and the distance forward to the burr's surface; 0 beside the burr.
  double passes[frame_side * frame_side], ahead[frame_side * frame_side];
  int seen = 0;
  const double offset = center.squaredNorm() - burr.radius * burr.radius;
  for (int j = 0; j < frame_side; ++j) {
    for (int i = 0; i < frame_side; ++i) {
      const Vec3 ray(across[0] + (i + 0.5) * dx, along[0] + (j + 0.5) * dy, 1.0);
      const double b = ray.dot(center), a = ray.squaredNorm(), inner = b * b - a * offset;
      const int at = j * frame_side + i;
      passes[at] = 1.0;
      ahead[at] = inner >= 0.0 ? (b - std::sqrt(inner)) / a : 0.0;
      seen += inner >= 0.0;
    }
  }
  if (seen == 0) return nowhere;

  for (std::size_t n = 0; n < parcels.size(); ++n) {
    const Vec3 place = eye.to(parcels.position[n]);
    if (place[2] <= 0.0 || place[2] >= center[2]) continue;
    const double x = place[0] / place[2], y = place[1] / place[2];
    const double radius = parcels.radius(n, quantum, parameters) / place[2];
    const double taken = opacity(parcels.mass[n], parameters);
    const int low_i = first_sample((x - radius - across[0]) / dx);
    const int low_j = first_sample((y - radius - along[0]) / dy);
    for (int j = low_j; j < frame_side; ++j) {
      const double v = along[0] + (j + 0.5) * dy - y;
      if (v > radius) break;
      for (int i = low_i; i < frame_side; ++i) {
        const double u = across[0] + (i + 0.5) * dx - x;
        if (u > radius) break;
        const int at = j * frame_side + i;
        if (u * u + v * v <= radius * radius && place[2] < ahead[at]) passes[at] *= 1.0 - taken;
      }
    }
  }
  double hidden = 0.0;
  for (int at = 0; at < frame_side * frame_side; ++at)
    if (ahead[at] > 0.0) hidden += 1.0 - passes[at];
  return hidden / seen;
}

}  // namespace burrlab
