// Voxel bone: construction, assignment, digest; test_hierarchy.cpp and tests/python have what changes it.
#include "burrlab/voxel_bone.hpp"

#include "brick_levels.hpp"
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

/// Takes levels from a voxel of brick 0, as a tick does.
void erode(VoxelBone& bone, std::size_t voxel, int levels) {
  std::uint8_t* tile = bone.open(0);
  tile[voxel] = static_cast<std::uint8_t>(tile[voxel] - levels);
  CHECK(bone.close({0, 0, 0}, 0, burrlab::sum_brick(tile), nullptr) == levels);
}

void check_construction() {
  const VoxelBone bone = some_bone();
  double sum = 0.0;
  for (const std::uint8_t level : some_levels()) sum += level;
  CHECK(bone.shape() == shape && bone.spacing() == spacing && bone.origin() == origin);
  CHECK_NEAR(bone.voxel_volume(), 0.008, 1e-15);
  CHECK_NEAR(bone.mass(), sum / 255.0 * 0.008, 1e-12);
  CHECK(bone.removed() == 0.0);

  const auto make = [](Index3 s, std::size_t n) {
    return VoxelBone(s, std::vector<std::uint8_t>(n), spacing, origin);
  };
  CHECK_THROWS(make(shape, count - 1), "levels do not fill the shape");
  CHECK_THROWS(make({1 << 16, 1 << 16, 8}, 0), "voxels / 8 of the volume must be below 2^32");
}

void check_assignment() {
  VoxelBone bone = some_bone();
  erode(bone, 5, 100);
  VoxelBone other({8, 8, 8}, 255, Vec3::Constant(1.0), Vec3::Zero());
  other = bone;
  CHECK(other.shape() == shape && other.digest() == bone.digest());
  erode(other, 6, 1);
  CHECK(other.digest() != bone.digest());
  other.reset();
  CHECK(other.digest() == some_bone().digest() && bone.removed() > 0.0);
}

void check_digest() {
  const VoxelBone bone = some_bone();
  const std::string digest = bone.digest();
  CHECK(digest.size() == 32);
  CHECK(digest == some_bone().digest());
  CHECK(digest == VoxelBone(bone).digest());

  VoxelBone eroded = bone;
  erode(eroded, 5, 1);
  CHECK(eroded.digest() != digest);  // q
  VoxelBone rewritten = eroded;
  rewritten.write({0, 0, 5}, {1, 1, 1}, eroded.density().data() + 5);
  CHECK(rewritten.density() == eroded.density());
  CHECK(rewritten.digest() != eroded.digest());  // p
  eroded.reset();
  CHECK(eroded.digest() == digest);

  // The same level in another voxel of the brick, in another brick, and at the volume's far corner.
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
  check_assignment();
  check_digest();
  return check::report();
}
