// Bones and frames shared by the tests of the effects.
#pragma once

#include <memory>
#include <vector>

#include "check.hpp"
#include "effects/effects.hpp"

namespace scenes {

using namespace burrlab;

inline const Material effects_material("bone", 2.145, 0.087, Shape::parabolic(), "");

/// 64^3 voxels of 0.25 mm from (0, 0, 0) on, 16 mm a side: solid below z = 8 mm.
inline VoxelBone half_full() {
  VoxelBone::Levels levels(64 * 64 * 64, 0);
  std::fill(levels.begin(), levels.begin() + 32 * 64 * 64, std::uint8_t(255));
  return VoxelBone({64, 64, 64}, levels, Vec3::Constant(0.25), Vec3::Constant(0.125));
}

/// Two tissues; the second, x >= 8 mm, bleeds.
inline void add_tissues(VoxelBone& bone) {
  Tissue hard, soft;
  hard.name = "bone";
  soft.name = "sinus";
  soft.label = 1;
  hard.c_e = soft.c_e = 2.145;
  hard.alpha = soft.alpha = 0.087;
  soft.bleeds = true;
  const Index3 n = bone.shape();
  std::vector<std::uint8_t> numbers(std::size_t(n[0] * n[1] * n[2]));
  for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = std::int64_t(i) % n[2] >= n[2] / 2;
  bone.set_tissues(std::make_shared<TissueMap>(n, numbers.data(), Tissues({hard, soft}, effects_material)));
}

/// Takes a sphere out of the bone; holds the changes for a frame of the effects.
struct Cut {
  std::vector<std::uint32_t> bricks;
  std::vector<std::uint8_t> density;
  BurrAt burr;

  Cut(VoxelBone& bone, const Vec3& center, double radius) : burr{center, radius} {
    const Index3 n = bone.shape();
    VoxelBone::Levels levels = bone.density();
    std::size_t i = 0;
    for (std::int64_t z = 0; z < n[0]; ++z)
      for (std::int64_t y = 0; y < n[1]; ++y)
        for (std::int64_t x = 0; x < n[2]; ++x, ++i) {
          const Vec3 place =
              bone.origin() + bone.spacing().cwiseProduct(Vec3(double(x), double(y), double(z)));
          if ((place - center).norm() >= radius) continue;
          levels[i] = 0;
        }
    bone.take_changed();
    bone.restore(levels.data());
    bricks = bone.take_changed();
    for (const std::uint32_t brick : bricks)
      density.insert(density.end(), bone.tile(brick), bone.tile(brick) + brick_voxels);
  }
  BrickLevels levels() const { return {bricks.data(), density.data(), bricks.size()}; }
};

inline bool exact(const Effects& effects) {
  bool all = true;
  for (const SubstanceBalance& balance : effects.balance()) all &= balance.exact();
  return all;
}

}  // namespace scenes
