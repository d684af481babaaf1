// The tick: faint mass, eroded fraction, erosion and its bookkeeping, and determinism, on every CPU path.
#include "burrlab/tick.hpp"

#include "burrlab/cpu_path.hpp"
#include "check.hpp"

using namespace burrlab;

namespace {

constexpr Scheme schemes[] = {Scheme::layer, Scheme::cell};

/// A solid cube of n voxels per side about the origin, spacing s [mm].
VoxelBone cube(int n, double s) {
  const Vec3 origin = Vec3::Constant(-0.5 * (n - 1) * s);
  return VoxelBone({n, n, n}, std::vector<std::uint8_t>(std::size_t(n) * n * n, 255), Vec3::Constant(s),
                   origin);
}

/// The part of the mass in voxels of pristine level 1 to 31, in bricks uniform and not.
void check_faint() {
  const Vec3 center = Vec3::Constant(2.01), spacing = Vec3::Constant(0.1);
  const auto sums_of = [&](VoxelBone bone) {
    const Tick tick(bone, 1.5, Scheme::layer, Shape::parabolic(), 1, 0);
    TickSums felt, fused;
    tick.moments(bone, center, &felt);
    tick.moments_and_erode(bone, center, ErosionSteps(0.1), 0, &fused);
    CHECK(felt.mass > 0 && felt.mass == fused.mass && felt.faint == fused.faint);
    return felt;
  };
  for (const int level : {1, 31, 32, 255}) {
    const TickSums sums =
        sums_of(VoxelBone({40, 40, 40}, static_cast<std::uint8_t>(level), spacing, Vec3::Zero()));
    CHECK(sums.faint == (level < 32 ? sums.mass : 0));
  }
  std::vector<std::uint8_t> mixed(64000), low(64000);
  for (std::size_t i = 0; i < mixed.size(); ++i) {
    mixed[i] = i % 3 ? 32 : 31;
    low[i] = i % 3 ? 0 : 31;
  }
  const TickSums all = sums_of(VoxelBone({40, 40, 40}, mixed, spacing, Vec3::Zero()));
  CHECK(all.faint == sums_of(VoxelBone({40, 40, 40}, low, spacing, Vec3::Zero())).mass &&
        all.faint < all.mass);
}

void check_eroded_fraction() {
  for (double a = 1e-6; a < 40.0; a *= 1.3) {
    const ErodedFraction fraction(a);
    CHECK(fraction.scale <= 0.125f);
    for (const float f : {0.0f, 0.1f, 0.5f, 1.0f}) {
      CHECK_NEAR(fraction(f), -std::expm1(-a * f), 4e-7 * -std::expm1(-a * f));
    }
  }
  CHECK(ErodedFraction(0.125).doublings == 0 && ErodedFraction(0.13).doublings == 1);
}

void check_erosion() {
  const VoxelBone fresh = cube(48, 0.1);
  const Vec3 center(0.013, -0.02, 2.0);
  for (const Scheme scheme : schemes) {
    const auto eroded = [&](std::uint64_t seed, std::uint64_t number, std::uint32_t index) {
      VoxelBone bone = fresh;
      TickSums sums;
      Tick(bone, 1.5, scheme, Shape::parabolic(), seed, index)
          .erode(bone, center, ErosionSteps(0.1), number, &sums);
      const VoxelBone::Levels left = bone.density();
      std::int64_t lost = 0;
      for (const std::uint8_t level : left) lost += 255 - level;
      CHECK(sums.lost > 0 && sums.lost == lost);
      CHECK_NEAR(bone.removed(), static_cast<double>(lost) / 255.0 * bone.voxel_volume(), 1e-12);
      CHECK_NEAR(fresh.mass() - bone.mass(), bone.removed(), 1e-9);
      return bone.digest();
    };
    const std::string digest = eroded(1, 7, 0);
    CHECK(digest == eroded(1, 7, 0));
    CHECK(digest != eroded(1, 7, 1));  // index
    CHECK(digest != eroded(1, 8, 0));  // tick
    CHECK(digest != eroded(1, 7 + (std::uint64_t{1} << 32), 0));
    CHECK(digest != eroded(2, 7, 0));  // seed
    CHECK(digest != eroded(1 + (std::uint64_t{1} << 32), 7, 0));
  }

  // Moments are those before the erosion; with a = 0 nothing erodes.
  VoxelBone bone = fresh;
  const Tick tick(bone, 1.5, Scheme::layer, Shape::parabolic(), 1, 0);
  const Moments before = tick.moments(bone, center);
  TickSums sums;
  CHECK(tick.moments_and_erode(bone, center, ErosionSteps(0.0), 0, &sums).m0 == before.m0);
  CHECK(sums.lost == 0 && bone.digest() == fresh.digest());
  CHECK(tick.moments_and_erode(bone, center, ErosionSteps(0.1), 0, &sums).m0 == before.m0);
  CHECK(tick.moments(bone, center).m0 < before.m0);
}

}  // namespace

int main() {
  check_faint();
  check_eroded_fraction();
  for (const std::string& path : cpu_paths()) {
    use_cpu_path(path);
    check_erosion();
  }
  return check::report();
}
