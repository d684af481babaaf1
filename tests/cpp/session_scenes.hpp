// Bones and tools shared by the tests of sessions.
#pragma once

#include <cmath>
#include <memory>

#include "burrlab/session/tick_executor.hpp"

namespace scenes {

using namespace burrlab;

inline const Material bone_material("bone", 2.145, 0.087, Shape::parse("parabolic"), "");
inline const Material pettigrew("pettigrew", 1.504, 0.116, Shape::parse("parabolic"), "");
inline const Material pvc("pvc", 0.462, 0.256, Shape::parse("parabolic"), "");

/// A block with its top at z = 0, 12 x 12 x 4 mm, voxels of 0.1 mm.
inline std::shared_ptr<VoxelBone> block() {
  return std::make_shared<VoxelBone>(Index3{40, 120, 120}, std::uint8_t(255), Vec3::Constant(0.1),
                                     Vec3(-5.95, -5.95, -3.95));
}

/// The same with a spherical hole of depth `depth`, as cut by a burr of this radius: voxels hold the share of
/// their volume outside the sphere.
inline std::shared_ptr<VoxelBone> block_with_hole(double radius, double depth) {
  const auto bone = block();
  VoxelBone::Levels levels = bone->density();
  std::size_t i = 0;
  for (int z = 0; z < 40; ++z)
    for (int y = 0; y < 120; ++y)
      for (int x = 0; x < 120; ++x, ++i) {
        const Vec3 place(-5.95 + 0.1 * x, -5.95 + 0.1 * y, -3.95 + 0.1 * z);
        const double share = ((place - Vec3(0.0, 0.0, radius - depth)).norm() - radius) / 0.1 + 0.5;
        levels[i] = std::uint8_t(std::lround(255.0 * std::min(1.0, std::max(0.0, share))));
      }
  bone->restore(levels.data());
  return bone;
}

inline TickExecutor executor(std::shared_ptr<VoxelBone> bone, const Material& material, double radius = 3.0,
                             double period = 1.0) {
  SessionSetup setup;
  setup.tools.push_back({Burr(radius), material});
  setup.seed = 5;
  setup.period = period;
  return TickExecutor(std::move(bone), setup);
}

/// Depth along -z at which the contact's force is `force`, from a centre above the bone; by bisection.
inline double depth_of(const TickExecutor& executor, double force, double top) {
  double low = 0.0, high = 3.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (executor.probe(0, Vec3(0.0, 0.0, top - middle)).force[2] < force ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

}  // namespace scenes
