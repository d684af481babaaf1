// Voxel bone: construction, writing, copies, mass and digest.
#include "burrlab/voxel_bone.hpp"

#include <limits>

#include "check.hpp"

using burrlab::Index3;
using burrlab::Vec3;
using burrlab::VoxelBone;

namespace {

const Vec3 spacing(0.1, 0.2, 0.4), origin(1.0, -2.0, 3.0);
const Index3 shape{9, 10, 11};
constexpr std::size_t count = 9 * 10 * 11;

std::vector<std::uint8_t> some_levels() {
  std::vector<std::uint8_t> levels(count);
  for (std::size_t i = 0; i < count; ++i) levels[i] = static_cast<std::uint8_t>(i * 37 % 256);
  return levels;
}

VoxelBone some_bone() { return VoxelBone(shape, some_levels(), spacing, origin); }

void check_construction() {
  const VoxelBone bone = some_bone();
  double sum = 0.0;
  for (const std::uint8_t level : some_levels()) sum += level;
  CHECK(bone.shape() == shape && bone.spacing() == spacing && bone.origin() == origin);
  CHECK_NEAR(bone.voxel_volume(), 0.008, 1e-15);
  CHECK_NEAR(bone.mass(), sum / 255.0 * 0.008, 1e-12);
  CHECK(bone.removed() == 0.0);

  const auto make = [](Index3 s, std::size_t n, const Vec3& step, const Vec3& first) {
    return VoxelBone(s, std::vector<std::uint8_t>(n), step, first);
  };
  const double nan = std::nan(""), inf = std::numeric_limits<double>::infinity();
  CHECK_THROWS(make({9, 0, 11}, 0, spacing, origin),
               "every side of the volume must be at least one voxel, got 0");
  CHECK_THROWS(make(shape, count - 1, spacing, origin), "levels do not fill the shape");
  CHECK_THROWS(make(shape, count, Vec3(0.1, 0.0, 0.1), origin), "spacing must be positive and finite, got 0");
  CHECK_THROWS(make(shape, count, Vec3(0.1, 0.1, -1.0), origin),
               "spacing must be positive and finite, got -1");
  CHECK_THROWS(make(shape, count, Vec3(nan, 0.1, 0.1), origin), "spacing must be positive and finite");
  CHECK_THROWS(make(shape, count, spacing, Vec3(0.0, 0.0, inf)), "origin must be finite, got inf");
  CHECK_THROWS(make({1 << 16, 1 << 16, 8}, 0, spacing, origin),
               "voxels / 8 of the volume must be below 2^32");
}

void check_write_and_reset() {
  VoxelBone bone = some_bone();
  const double before = bone.mass();
  bone.eroded()[5] -= 100;  // level 185
  bone.account(100);
  CHECK_NEAR(bone.removed(), 100 / 255.0 * 0.008, 1e-15);
  CHECK_NEAR(bone.mass() + bone.removed(), before, 1e-12);

  const VoxelBone copy = bone;
  CHECK(copy.pristine() == bone.pristine());  // shared
  CHECK(copy.density() != bone.density());
  const std::vector<std::uint8_t> box{1, 2, 3, 4, 5, 6, 7, 8};
  bone.write({7, 8, 9}, {2, 2, 2}, box.data());
  CHECK(copy.pristine() != bone.pristine());
  const std::size_t first = (7 * 10 + 8) * 11 + 9, last = count - 1;
  CHECK(bone.density()[first] == 1 && bone.pristine()[first] == 1);
  CHECK(bone.density()[last] == 8 && bone.pristine()[last] == 8);
  CHECK(copy.pristine()[last] == some_levels()[last] && copy.density()[last] == some_levels()[last]);
  CHECK_NEAR(bone.removed(), 100 / 255.0 * 0.008, 1e-15);
  double sum = 0.0;
  for (std::size_t i = 0; i < count; ++i) sum += bone.density()[i];
  CHECK_NEAR(bone.mass(), sum / 255.0 * 0.008, 1e-12);

  bone.reset();
  CHECK(bone.removed() == 0.0);
  CHECK(bone.density()[5] == 185);
  CHECK(copy.density()[5] == 85);

  const double mass = bone.mass();
  bone.write({0, 0, 0}, {0, 2, 2}, box.data());  // an empty box
  CHECK(bone.mass() == mass);
  CHECK_THROWS((bone.write({8, 0, 0}, {2, 2, 2}, box.data()), 0),
               "values must lie inside the volume: along axis 0 (z, y, x) 2 voxels from 8 of 9");
  CHECK_THROWS((bone.write({0, 0, -1}, {2, 2, 2}, box.data()), 0),
               "along axis 2 (z, y, x) 2 voxels from -1 of 11");
  CHECK(bone.mass() == mass);
}

void check_digest() {
  const VoxelBone bone = some_bone();
  const std::string digest = bone.digest();
  CHECK(digest.size() == 32);
  CHECK(digest == some_bone().digest());
  CHECK(digest == VoxelBone(bone).digest());

  VoxelBone eroded = bone;
  eroded.eroded()[5] -= 1;
  eroded.account(1);
  CHECK(eroded.digest() != digest);  // q
  VoxelBone rewritten = eroded;
  rewritten.write({0, 0, 5}, {1, 1, 1}, eroded.density() + 5);
  CHECK(rewritten.digest() != eroded.digest());  // p
  eroded.reset();
  CHECK(eroded.digest() == digest);

  // The same level in another voxel of its brick, in another brick, and at the volume's far corner.
  std::string last = "none";
  for (const std::size_t at : {std::size_t{0}, std::size_t{1}, std::size_t{11}, std::size_t{8}, count - 1}) {
    std::vector<std::uint8_t> levels(count);
    levels[at] = 1;
    const std::string here = VoxelBone(shape, levels, spacing, origin).digest();
    CHECK(here != last);
    last = here;
  }
  CHECK(VoxelBone(shape, some_levels(), Vec3(0.1, 0.2, 0.3), origin).digest() != digest);
  CHECK(VoxelBone(shape, some_levels(), spacing, Vec3(1.0, -2.0, 3.1)).digest() != digest);
  CHECK(VoxelBone({10, 9, 11}, some_levels(), spacing, origin).digest() != digest);
}

}  // namespace

int main() {
  check_construction();
  check_write_and_reset();
  check_digest();
  return check::report();
}
