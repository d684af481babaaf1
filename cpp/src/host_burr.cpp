#include "burrlab/host_burr.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "require.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {

// The scale of A [mm a unit of the host]; throws unless A A^T is a multiple of 1.
static double scale_of(const std::array<double, 12>& to_bone) {
  const StandardArithmetic arithmetic;
  const auto product = [&](std::size_t i, std::size_t j) {
    double sum = 0.0;
    for (std::size_t k = 0; k < 3; ++k) sum += to_bone[4 * i + k] * to_bone[4 * j + k];
    return sum;
  };
  for (const double x : to_bone) require_finite("to_bone", x);
  const double squared = (product(0, 0) + product(1, 1) + product(2, 2)) / 3.0;
  require_positive("scale of to_bone", squared);
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j <= i; ++j)
      if (!(std::abs(product(i, j) - (i == j ? squared : 0.0)) <= 1e-6 * squared))
        throw InvalidArgument(
            "to_bone must be a rotation or its mirror image, times one scale, and an offset");
  return std::sqrt(squared);
}

HostBurr::HostBurr(std::shared_ptr<VoxelBone> bone, const Burr& burr, const Material& material,
                   const HostSettings& settings)
    : contact_(std::move(bone), burr, material, settings.seed, settings.index, settings.scheme),
      settings_(settings),
      scale_(scale_of(settings.to_bone)) {
  if (!(settings.longest_tick >= 0.01)) refuse("longest_tick", "at least 0.01 ms", settings.longest_tick);
}

Vec3 HostBurr::to_bone(const Vec3& position) const {
  const StandardArithmetic arithmetic;
  const auto& m = settings_.to_bone;
  Vec3 out;
  for (std::size_t i = 0; i < 3; ++i)
    out[Eigen::Index(i)] =
        m[4 * i] * position[0] + m[4 * i + 1] * position[1] + m[4 * i + 2] * position[2] + m[4 * i + 3];
  return out;
}

Vec3 HostBurr::turned_to_host(const Vec3& direction) const {
  const StandardArithmetic arithmetic;
  Vec3 out = Vec3::Zero();
  for (std::size_t i = 0; i < 12; ++i)
    if (i % 4 < 3) out[Eigen::Index(i % 4)] += settings_.to_bone[i] / scale_ * direction[Eigen::Index(i / 4)];
  return out;
}

Vec3 HostBurr::to_host(const Vec3& position) const {
  const StandardArithmetic arithmetic;
  const auto& m = settings_.to_bone;
  return turned_to_host(position - Vec3(m[3], m[7], m[11])) / scale_;
}

HostForce HostBurr::step(const Vec3& center, double dt, bool on, const Vec3& reference) noexcept try {
  const StandardArithmetic arithmetic;
  if (!(dt > 0.0 && dt <= longest_step)) refuse("dt", "above 0 and at most 1000 ms", dt);
  require_finite("reference", reference);
  const Vec3 end = to_bone(center);
  require_finite("center", end);
  const VoxelBone::Changing changing(*contact_.bone());
  HostForce feel;
  feel.ticks = std::max(1, int(std::ceil(dt / settings_.longest_tick - 1e-9)));
  const ErosionSteps* steps = on ? &contact_.steps_of(dt / feel.ticks) : nullptr;
  const Vec3 way = lifted_ ? Vec3(Vec3::Zero()) : Vec3(end - center_);
  for (int i = 1; i <= feel.ticks; ++i) {
    last_ = contact_.step(end - way * (double(feel.ticks - i) / feel.ticks), steps);
    feel.removed += last_.removed;
  }
  center_ = end;
  lifted_ = false;
  feel.force = turned_to_host(last_.force);
  feel.torque = (center - reference).cross(feel.force);
  return feel;
} catch (const std::exception& error) {
  HostForce feel;
  feel.refused = (refused_ = error.what()).c_str();
  return feel;
}

}  // namespace burrlab
