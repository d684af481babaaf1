// Voxel bone: construction, reading, writing, copies, mass and digest.
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
  erode(bone, 5, 100);  // level 185
  CHECK_NEAR(bone.removed(), 100 / 255.0 * 0.008, 1e-15);
  CHECK_NEAR(bone.mass() + bone.removed(), before, 1e-12);

  const VoxelBone copy = bone;
  CHECK(copy.pristine() == bone.pristine() && copy.pristine() == some_levels());
  CHECK(copy.density() == bone.density() && copy.density()[5] == 85);
  const std::vector<std::uint8_t> box{1, 2, 3, 4, 5, 6, 7, 8};
  bone.write({7, 8, 9}, {2, 2, 2}, box.data());
  CHECK(copy.pristine() == some_levels() && copy.pristine() != bone.pristine());
  CHECK(copy.density() != bone.density());
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
  CHECK(bone.density()[5] == 185 && bone.density() == bone.pristine());
  CHECK(copy.density()[5] == 85);  // the copy is not eroded further

  const double mass = bone.mass();
  bone.write({0, 0, 0}, {0, 2, 2}, box.data());  // an empty box
  CHECK(bone.mass() == mass);
  CHECK_THROWS((bone.write({8, 0, 0}, {2, 2, 2}, box.data()), 0),
               "values must lie inside the volume: along axis 0 (z, y, x) 2 voxels from 8 of 9");
  CHECK_THROWS((bone.write({0, 0, -1}, {2, 2, 2}, box.data()), 0),
               "along axis 2 (z, y, x) 2 voxels from -1 of 11");
  CHECK(bone.mass() == mass);
}

void check_read_and_restore() {
  const VoxelBone fresh = some_bone();
  VoxelBone bone = fresh;
  erode(bone, 5, 100);
  CHECK(fresh.density() == some_levels() && fresh.pristine() == some_levels());

  // A box in eight bricks, present and pristine.
  const Index3 start{0, 7, 3}, size{9, 3, 7};
  const std::vector<std::uint8_t> now = bone.read(start, size, false), before = bone.read(start, size, true);
  CHECK(now.size() == 9 * 3 * 7 && before.size() == now.size());
  bool same = true;
  for (std::int64_t i = 0; i < 9 * 3 * 7; ++i) {
    const std::int64_t z = i / 21, y = 7 + i / 7 % 3, x = 3 + i % 7;
    const auto at = static_cast<std::size_t>((z * 10 + y) * 11 + x);
    same = same && now[std::size_t(i)] == bone.density()[at] && before[std::size_t(i)] == some_levels()[at];
  }
  CHECK(same);
  CHECK(bone.read({0, 0, 5}, {1, 1, 1}, false)[0] == 85 && bone.read({0, 0, 5}, {1, 1, 1}, true)[0] == 185);
  CHECK(bone.read({9, 10, 11}, {0, 0, 0}, false).empty());  // an empty box at the far corner
  CHECK_THROWS(bone.read({0, 0, 5}, {1, 1, 7}, false),
               "must lie inside the volume: along axis 2 (z, y, x) 7 voxels from 5 of 11");
  CHECK_THROWS(bone.read({0, -1, 0}, {1, 1, 1}, true), "along axis 1 (z, y, x) 1 voxels from -1 of 10");

  // A snapshot replaces the present levels and keeps the pristine ones, which it may not exceed.
  VoxelBone other = fresh;
  other.restore(bone.density().data());
  CHECK(other.digest() == bone.digest() && other.removed() == bone.removed() && other.mass() == bone.mass());
  std::vector<std::uint8_t> above = some_levels();
  ++above[count - 1];
  const auto refused = [&] { return other.restore(above.data()), 0; };
  CHECK_THROWS(refused(), "density must be at most the pristine level, got 242 over 241");
  CHECK(other.digest() == bone.digest());
  other.restore(fresh.density().data());
  CHECK(other.digest() == fresh.digest() && other.removed() == 0.0);
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
  check_write_and_reset();
  check_read_and_restore();
  check_assignment();
  check_digest();
  return check::report();
}
