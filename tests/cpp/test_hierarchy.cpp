// Sums, occupancy bits and pristine levels of bricks agree with the voxels after any operation.
#include <algorithm>
#include <random>

#include "brick_levels.hpp"
#include "burrlab/brick.hpp"
#include "check.hpp"
#include "cpu_path.hpp"
#include "tick.hpp"

using namespace burrlab;

namespace {

using Levels = VoxelBone::Levels;
const Vec3 spacing(0.25, 0.25, 0.25);

std::size_t count(const Index3& n) { return static_cast<std::size_t>(n[0] * n[1] * n[2]); }

template <class Visit>
void each(const Index3& n, Visit visit) {
  for (std::int64_t z = 0; z < n[0]; ++z)
    for (std::int64_t y = 0; y < n[1]; ++y)
      for (std::int64_t x = 0; x < n[2]; ++x) visit(z, y, x);
}

BrickSums plain_sums(const std::uint8_t* tile) {
  BrickSums sums;
  each({8, 8, 8}, [&](std::int64_t z, std::int64_t y, std::int64_t x) {
    const std::uint32_t q = *tile++;
    sums.mass += q;
    sums.x += q * static_cast<std::uint32_t>(x);
    sums.y += q * static_cast<std::uint32_t>(y);
    sums.z += q * static_cast<std::uint32_t>(z);
  });
  return sums;
}

bool equal(const BrickSums& a, const BrickSums& b) {
  return a.mass == b.mass && a.x == b.x && a.y == b.y && a.z == b.z;
}

/// Sums, tiles, pristine tiles and flags of every brick against the dense levels.
void check_bricks(const VoxelBone& bone) {
  const Index3 &shape = bone.shape(), &bricks = bone.bricks();
  const Levels density = bone.density(), pristine = bone.pristine();
  bool sums_right = true, tiles_right = true, pristine_right = true, faint_right = true;
  std::uint64_t mass = 0;
  each(bricks, [&](std::int64_t bz, std::int64_t by, std::int64_t bx) {
    const std::size_t number = bone.brick_number(bz, by, bx);
    const std::uint8_t *tile = bone.tile(number), *before = bone.pristine_tile(number);
    sums_right =
        sums_right && equal(bone.sums(number), plain_sums(tile)) && equal(sum_brick(tile), plain_sums(tile));
    mass += bone.sums(number).mass;
    bool faint = false;
    each({8, 8, 8}, [&](std::int64_t z, std::int64_t y, std::int64_t x) {
      const std::int64_t i = 8 * bz + z, j = 8 * by + y, k = 8 * bx + x;
      const bool inside = i < shape[0] && j < shape[1] && k < shape[2];
      const auto voxel = static_cast<std::size_t>((i * shape[1] + j) * shape[2] + k);
      const std::uint8_t q = tile[(z * 8 + y) * 8 + x];
      const int p = before ? before[(z * 8 + y) * 8 + x] : bone.pristine_level(number);
      tiles_right = tiles_right && q == (inside ? density[voxel] : 0);
      if (inside) pristine_right = pristine_right && p == pristine[voxel] && q <= p;
      faint = faint || (inside && p > 0 && p < 32);
    });
    faint_right = faint_right && bone.has_faint(number) == faint;
  });
  CHECK(sums_right);
  CHECK(tiles_right);
  CHECK(pristine_right);
  CHECK(faint_right);
  CHECK_NEAR(bone.mass(), static_cast<double>(mass) * (bone.voxel_volume() / 255.0), 0.0);
}

/// A brick's bit is set if it holds bone, a block's if one of its bits is; no bit beyond the bricks.
void check_occupancy(const VoxelBone& bone) {
  const Occupancy& occupancy = bone.occupancy();
  const Index3 &bricks = bone.bricks(), &blocks = occupancy.blocks(), &above = occupancy.blocks_of_blocks();
  for (int axis = 0; axis < 3; ++axis)
    CHECK(blocks[axis] == (bricks[axis] + 3) / 4 && above[axis] == (blocks[axis] + 3) / 4);
  bool right = true;
  each({4 * blocks[0], 4 * blocks[1], 4 * blocks[2]}, [&](std::int64_t z, std::int64_t y, std::int64_t x) {
    const bool inside = z < bricks[0] && y < bricks[1] && x < bricks[2];
    const bool holds = inside && bone.sums(bone.brick_number(z, y, x)).mass > 0;
    right = right && (occupancy.block(z / 4, y / 4, x / 4) >> Occupancy::bit(z, y, x) & 1) == holds;
  });
  CHECK(right);
  bool right_above = true;
  each({4 * above[0], 4 * above[1], 4 * above[2]}, [&](std::int64_t z, std::int64_t y, std::int64_t x) {
    const bool inside = z < blocks[0] && y < blocks[1] && x < blocks[2];
    const bool holds = inside && occupancy.block(z, y, x) != 0;
    right_above = right_above &&
                  (occupancy.block_of_blocks(z / 4, y / 4, x / 4) >> Occupancy::bit(z, y, x) & 1) == holds;
  });
  CHECK(right_above);
}

void check_all(const VoxelBone& bone) {
  check_bricks(bone);
  check_occupancy(bone);
}

bool nothing_set(const VoxelBone& bone) {
  bool none = true;
  const Occupancy& occupancy = bone.occupancy();
  each(occupancy.blocks(),
       [&](std::int64_t z, std::int64_t y, std::int64_t x) { none = none && occupancy.block(z, y, x) == 0; });
  each(occupancy.blocks_of_blocks(), [&](std::int64_t z, std::int64_t y, std::int64_t x) {
    none = none && occupancy.block_of_blocks(z, y, x) == 0;
  });
  return none;
}

/// Random writes, ticks, resets, copies and snapshots; some boxes are uniform, some empty.
void check_random_sequences(const Index3& shape, unsigned seed) {
  std::mt19937 random(seed);
  const auto below = [&](std::int64_t n) { return std::int64_t(random() % std::uint64_t(n)); };
  const std::vector<std::string> paths = cpu_paths();
  VoxelBone bone(shape, 255, spacing, Vec3::Zero());
  for (int i = 0; i < 40; ++i) {
    const std::int64_t what = below(8);
    if (what < 3) {
      Index3 start, size;
      for (int axis = 0; axis < 3; ++axis) {
        start[axis] = below(shape[axis]);
        size[axis] = 1 + below(std::min<std::int64_t>(shape[axis] - start[axis], 20));
      }
      Levels box(count(size), static_cast<std::uint8_t>(what == 0 ? 0 : below(256)));
      if (what == 1)
        for (std::uint8_t& level : box) level = static_cast<std::uint8_t>(below(256));
      bone.write(start, size, box.data());
    } else if (what < 6) {
      use_cpu_path(paths[std::size_t(below(std::int64_t(paths.size())))]);
      const Tick tick(bone, 2.0, what == 3 ? Scheme::cell : Scheme::layer, Shape::parse("constant"), seed, 0);
      Vec3 center;
      for (int axis = 0; axis < 3; ++axis) center[axis] = spacing[axis] * double(below(shape[2 - axis]));
      tick.erode(bone, center, ErosionSteps(0.1 * double(1 + below(100))), std::uint64_t(i));
    } else if (what == 6) {
      VoxelBone copy = bone;
      Levels less = copy.density();
      for (std::uint8_t& level : less) level = static_cast<std::uint8_t>(level / 2);
      copy.restore(less.data());
      bone = copy;
    } else if (below(3) == 0) {
      bone.reset();
      CHECK(bone.removed() == 0.0 && bone.density() == bone.pristine());
    }
    check_all(bone);
  }
}

/// A cut through a long volume, until nothing is left: bricks, blocks and blocks of blocks empty one by one.
void check_eroding_everything_away() {
  for (const std::string& path : cpu_paths()) {
    use_cpu_path(path);
    for (const bool along_x : {true, false}) {
      const Index3 shape = along_x ? Index3{5, 9, 300} : Index3{300, 9, 5};
      VoxelBone bone(shape, 255, spacing, Vec3::Zero());
      CHECK(!nothing_set(bone));
      const Tick tick(bone, 3.0, Scheme::cell, Shape::parse("constant"), 1, 0);
      for (int i = 0; i <= 150; ++i) {
        const double along = 0.5 * i;
        tick.erode(bone, along_x ? Vec3(along, 1.0, 0.5) : Vec3(0.5, 1.0, along), ErosionSteps(100.0),
                   std::uint64_t(i));
        if (i % 30 == 0) check_all(bone);
      }
      check_all(bone);
      CHECK(bone.mass() == 0.0 && nothing_set(bone));
      bone.reset();
      check_all(bone);
      CHECK(bone.removed() == 0.0 && !nothing_set(bone));
    }
  }
}

/// A uniform brick has no pristine copy; another brick has none until it is to be eroded.
void check_pristine_copies() {
  const Index3 shape{16, 16, 20};  // the last bricks along x extend beyond the volume
  const Vec3 center(1.9, 1.9, 2.0);
  for (const int level : {255, 100, 7}) {
    VoxelBone bone(shape, static_cast<std::uint8_t>(level), spacing, Vec3::Zero());
    VoxelBone written(shape, 0, spacing, Vec3::Zero());
    const Levels same(count(shape), static_cast<std::uint8_t>(level));
    written.write({0, 0, 0}, shape, same.data());
    const Tick tick(bone, 2.0, Scheme::layer, Shape::parabolic(), 1, 0);
    for (VoxelBone* one : {&bone, &written}) {
      for (const bool eroded : {false, true}) {
        if (eroded) tick.erode(*one, center, ErosionSteps(2.0), 0);
        CHECK((one->removed() > 0.0) == eroded);
        for (std::size_t brick = 0; brick < count(one->bricks()); ++brick)
          CHECK(one->pristine_tile(brick) == nullptr && one->pristine_level(brick) == level);
        CHECK(one->pristine() == same);
        check_all(*one);
      }
    }
    CHECK(bone.digest() == written.digest());
  }

  Levels levels(count(shape), 255);
  levels[0] = 254;  // brick 0 is not uniform, the others are
  VoxelBone bone(shape, levels, spacing, Vec3::Zero());
  CHECK(bone.pristine_tile(0) == bone.tile(0) && bone.pristine_tile(1) == nullptr);
  VoxelBone copy = bone;
  CHECK(copy.pristine_tile(0) == copy.tile(0) && copy.tile(0) != bone.tile(0));
  Tick(bone, 2.0, Scheme::layer, Shape::parabolic(), 1, 0).erode(bone, center, ErosionSteps(2.0), 0);
  CHECK(bone.removed() > 0.0 && bone.pristine_tile(0) != bone.tile(0) && bone.pristine_tile(1) == nullptr);
  CHECK(bone.pristine() == levels && copy.density() == levels && copy.pristine_tile(0) == copy.tile(0));
  copy = bone;
  CHECK(copy.pristine_tile(0) != bone.pristine_tile(0) && copy.pristine() == levels);
  bone.reset();
  CHECK(bone.density() == levels && bone.pristine() == levels);
  check_all(bone);
  const std::uint8_t solid = 255;
  bone.write({0, 0, 0}, {1, 1, 1}, &solid);  // brick 0 is uniform
  CHECK(bone.pristine_tile(0) == nullptr && bone.pristine_level(0) == 255);
  check_all(bone);
}

void check_bytes() {
  const Index3 shape{256, 256, 256};
  const VoxelBone bone(shape, 255, spacing, Vec3::Zero());
  CHECK(bone.hierarchy_bytes() <= count(shape) / 25);  // 4 %
  CHECK(bone.hierarchy_bytes() >= count(bone.bricks()) * sizeof(BrickSums));
}

}  // namespace

int main() {
  unsigned seed = 0;
  for (const Index3& shape : {Index3{8, 8, 8}, Index3{17, 9, 23}, Index3{40, 33, 41}, Index3{3, 5, 150}})
    for (int repeat = 0; repeat < 4; ++repeat) check_random_sequences(shape, ++seed);
  check_eroding_everything_away();
  check_pristine_copies();
  check_bytes();
  return check::report();
}
