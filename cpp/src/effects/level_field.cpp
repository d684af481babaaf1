#include "effects/level_field.hpp"

#include <cstring>
#include <limits>

namespace burrlab {
namespace {

// Every cell of a grid that a segment meets, in order.
// Amanatides, Woo, A fast voxel traversal algorithm for ray tracing, Eurographics 1987.
using Cell3 = std::array<std::int64_t, 3>;  // (x, y, z)

/// Visits the cells of edge `size` in [low, high) on `from + t move`, t in [begin, end]. visit(cell, t, axis)
/// gets the t of entry and the axis of entry, -1 at the beginning; it returns true to stop.
template <class Visit>
bool walk_grid(const Vec3& from, const Vec3& move, double begin, double end, double size, const Cell3& low,
               const Cell3& high, int axis, Visit visit) {
  Cell3 cell;
  double next[3];
  const auto crossing = [&](int i) {
    if (move[i] == 0.0) return std::numeric_limits<double>::infinity();
    return (double(cell[i] + (move[i] > 0.0)) * size - from[i]) / move[i];
  };
  for (int i = 0; i < 3; ++i) {
    // Truncation rounds down: `low` is not negative.
    cell[i] = std::clamp(std::int64_t((from[i] + begin * move[i]) / size), low[i], high[i] - 1);
    next[i] = crossing(i);
  }
  for (double t = begin;;) {
    if (visit(cell, t, axis)) return true;
    axis = next[0] <= next[1] ? (next[0] <= next[2] ? 0 : 2) : (next[1] <= next[2] ? 1 : 2);
    if (next[axis] > end) return false;
    t = std::max(t, next[axis]);
    cell[axis] += move[axis] > 0.0 ? 1 : -1;
    if (cell[axis] < low[axis] || cell[axis] >= high[axis]) return false;
    next[axis] = crossing(axis);
  }
}

}  // namespace

LevelField::LevelField(const VoxelBone& bone, int solid_level)
    : shape_(bone.shape()),
      bricks_(bone.bricks()),
      spacing_(bone.spacing()),
      low_(bone.origin() - 0.5 * bone.spacing()),
      per_mm_(bone.spacing().cwiseInverse()),
      solid_level_(solid_level),
      levels_(bone.brick_count()),
      solid_(bone.brick_count(), 0),
      tissues_(bone.tissues()) {
  high_ = low_ + spacing_.cwiseProduct(Vec3(double(shape_[2]), double(shape_[1]), double(shape_[0])));
  for (std::size_t brick = 0; brick < solid_.size(); ++brick)
    if (bone.sums(brick).mass) exchange(brick, bone.tile(brick));
}

BrickLoss LevelField::exchange(std::size_t brick, const std::uint8_t* density) {
  BrickLoss loss;
  std::uint8_t* mine = levels_.tile(brick);
  std::uint8_t largest = 0;
  for (int i = 0; i < brick_voxels; ++i) {
    const int fall = int(mine[i]) - int(density[i]);
    loss.by_voxel[std::size_t(i)] = static_cast<std::uint8_t>(std::max(fall, 0));
    loss.lost += std::max(fall, 0);
    loss.rose |= fall < 0;
    largest = std::max(largest, density[i]);
  }
  std::memcpy(mine, density, brick_voxels);
  solid_[brick] = largest >= solid_level_;
  return loss;
}

Vec3 LevelField::center(const Index3& voxel) const {
  return low_ +
         spacing_.cwiseProduct(Vec3(double(voxel[2]) + 0.5, double(voxel[1]) + 0.5, double(voxel[0]) + 0.5));
}

Vec3 LevelField::center(std::size_t brick, int voxel) const {
  const Index3 at = place_in(bricks_, std::int64_t(brick));
  return center({at[0] * 8 + (voxel >> 6), at[1] * 8 + (voxel >> 3 & 7), at[2] * 8 + (voxel & 7)});
}

bool LevelField::first_hit(const Vec3& from, const Vec3& move, LevelHit& hit) const {
  const Vec3 start = (from - low_).cwiseProduct(per_mm_), way = move.cwiseProduct(per_mm_);
  double begin = 0.0, end = 1.0;
  int entered = -1;
  for (int axis = 0; axis < 3; ++axis) {
    const double size = double(shape_[2 - axis]);
    if (way[axis] == 0.0) {
      if (start[axis] < 0.0 || start[axis] >= size) return false;
      continue;
    }
    const double to_low = -start[axis] / way[axis], to_high = (size - start[axis]) / way[axis];
    const double in = std::min(to_low, to_high);
    if (in > begin) {
      begin = in;
      entered = axis;
    }
    end = std::min(end, std::max(to_low, to_high));
  }
  if (begin > end) return false;
  const Cell3 none{0, 0, 0}, all{bricks_[2], bricks_[1], bricks_[0]};
  return walk_grid(start, way, begin, end, 8.0, none, all, entered,
                   [&](const Cell3& brick, double t, int by) {
                     if (!solid_[number_in(bricks_, {brick[2], brick[1], brick[0]})]) return false;
                     Cell3 low, high;
                     for (int axis = 0; axis < 3; ++axis) {
                       low[axis] = 8 * brick[axis];
                       high[axis] = std::min(low[axis] + 8, shape_[2 - axis]);
                     }
                     return walk_grid(start, way, t, end, 1.0, low, high, by,
                                      [&](const Cell3& cell, double at, int along) {
                                        if (along < 0 || !solid(Index3{cell[2], cell[1], cell[0]}))
                                          return false;
                                        hit.part = at;
                                        hit.voxel = {cell[2], cell[1], cell[0]};
                                        hit.face = Vec3::Zero();
                                        hit.face[along] = way[along] > 0.0 ? -1.0 : 1.0;
                                        return true;
                                      });
                   });
}

Vec3 LevelField::normal(const LevelHit& hit) const {
  Vec3 fall = Vec3::Zero();
  for (int axis = 0; axis < 3; ++axis) {
    for (int far = 1; far <= 2; ++far) {
      Index3 before = hit.voxel, after = hit.voxel;
      before[2 - axis] -= far;
      after[2 - axis] += far;
      fall[axis] += double(level(before[0], before[1], before[2]) - level(after[0], after[1], after[2]));
    }
    fall[axis] *= per_mm_[axis];
  }
  const double length = fall.norm();
  if (!(fall.dot(hit.face) > 0.1 * length)) return hit.face;
  return fall / length;
}

}  // namespace burrlab
