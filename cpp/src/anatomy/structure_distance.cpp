#include "burrlab/anatomy/structure_distance.hpp"

#include <cstring>

#include "brick_walk.hpp"
#include "require.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {
namespace {

constexpr std::int64_t block_side = brick_side * Occupancy::fan;

const VoxelBone& checked(const VoxelBone& bone, std::size_t tissue) {
  if (!bone.tissues()) throw InvalidArgument("bone must have tissues, got one of a single material");
  const std::size_t count = bone.tissues()->table().size();
  if (tissue >= count) refuse("tissue", "below " + std::to_string(count), double(tissue));
  return bone;
}

bool holds(const std::uint8_t* row, std::uint64_t numbers) {
  std::uint64_t bytes;
  std::memcpy(&bytes, row, sizeof bytes);
  bytes ^= numbers;
  return ((bytes - 0x0101010101010101u) & ~bytes & 0x8080808080808080u) != 0;
}

}  // namespace

struct StructureSearch::Best {
  double squared;
  NearestVoxel& nearest;
  Index3 first{}, last{};  // voxels that may be nearer
  bool any = false;        // one is below the bound
  void take(double value, const Index3& at) {
    squared = value;
    nearest.at = at;
    nearest.any = any = true;
  }
};

StructureSearch::StructureSearch(const VoxelBone& bone, std::size_t tissue)
    : map_(checked(bone, tissue).tissues()),
      tissue_(tissue),
      shape_(bone.shape()),
      bricks_(bone.bricks()),
      spacing_(bone.spacing()),
      origin_(bone.origin()),
      where_(bricks_) {
  Index3 first = shape_, last{-1, -1, -1};
  for (std::size_t brick = 0; brick < bone.brick_count(); ++brick) {
    if (!(map_->present(brick) >> tissue & 1)) continue;
    const Index3 at = bone.place(brick), n = bone.extent(brick);
    where_.set(at, true);
    const std::uint8_t* tile = map_->tile(brick);
    each_place({0, 0, 0}, {n[0] - 1, n[1] - 1, n[2] - 1}, [&](const Index3& in) {
      if (tile && tile[64 * in[0] + 8 * in[1] + in[2]] != tissue) return;
      for (int axis = 0; axis < 3; ++axis) {
        first[axis] = std::min(first[axis], 8 * at[axis] + in[axis]);
        last[axis] = std::max(last[axis], 8 * at[axis] + in[axis]);
      }
    });
  }
  if (last[0] < 0)
    throw InvalidArgument("structure must have voxels, '" + map_->table()[tissue].name + "' has none");
  for (int axis = 0; axis < 3; ++axis) {
    low_[axis] = edge(axis, first[2 - axis]);
    high_[axis] = edge(axis, last[2 - axis] + 1);
  }
}

// Distance from a point to the voxels first..last along an axis. A larger range is never farther, to the last
// bit, because equal edges are rounded equally.
double StructureSearch::gap(int axis, double point, std::int64_t first, std::int64_t last) const {
  return std::max({edge(axis, first) - point, point - edge(axis, last + 1), 0.0});
}

double StructureSearch::distance(const Vec3& point, NearestVoxel& nearest, double bound) const noexcept {
  const StandardArithmetic arithmetic;
  if (!std::isfinite(point[0] + point[1] + point[2]) || std::isnan(bound))
    return std::numeric_limits<double>::infinity();
  const auto squared_to = [&](const Index3& first, const Index3& last) {
    const double z = gap(2, point[2], first[0], last[0]), y = gap(1, point[1], first[1], last[1]);
    const double x = gap(0, point[0], first[2], last[2]);
    return z * z + y * y + x * x;
  };
  Best best{bound * bound, nearest};
  if (nearest.any) {
    const double known = squared_to(nearest.at, nearest.at);
    if (known < best.squared) best.take(known, nearest.at);
  }
  const double reach = std::sqrt(best.squared);
  std::int64_t first[3], last[3];  // bricks (x, y, z)
  for (int axis = 0; axis < 3; ++axis) {
    const auto most = double(shape_[2 - axis] - 1);
    const double low = (point[axis] - reach - origin_[axis]) / spacing_[axis] - 0.51;
    const double high = (point[axis] + reach - origin_[axis]) / spacing_[axis] + 0.51;
    best.first[2 - axis] = std::int64_t(std::clamp(low, 0.0, most));
    best.last[2 - axis] = std::int64_t(std::clamp(high, 0.0, most));
    first[axis] = best.first[2 - axis] / brick_side;
    last[axis] = best.last[2 - axis] / brick_side;
  }
  constexpr int fan = Occupancy::fan;
  const Index3 begin{first[2] / fan, first[1] / fan, first[0] / fan};
  each_place(begin, {last[2] / fan, last[1] / fan, last[0] / fan}, [&](const Index3& block) {
    const auto [z, y, x] = block;
    std::uint64_t bricks = where_.block(z, y, x) & children_within(first, last, z, y, x);
    if (!bricks) return;
    const Index3 low{block_side * z, block_side * y, block_side * x};
    const Index3 high{low[0] + block_side - 1, low[1] + block_side - 1, low[2] + block_side - 1};
    if (squared_to(low, high) >= best.squared) return;
    for (; bricks; bricks &= bricks - 1) {
      const int bit = int(lowest_bit(bricks));
      search_brick({fan * z + (bit >> 4), fan * y + (bit >> 2 & 3), fan * x + (bit & 3)}, point, best);
    }
  });
  return best.any ? std::sqrt(best.squared) : std::numeric_limits<double>::infinity();
}

void StructureSearch::search_brick(const Index3& brick, const Vec3& point, Best& best) const {
  Index3 first, last;
  double least[3];  // (z, y, x)
  for (int i = 0; i < 3; ++i) {
    first[i] = std::max<std::int64_t>(brick_side * brick[i], best.first[i]);
    last[i] = std::min<std::int64_t>(brick_side * brick[i] + brick_side - 1, best.last[i]);
    least[i] = gap(2 - i, point[2 - i], first[i], last[i]);
  }
  const double squared = least[0] * least[0] + least[1] * least[1] + least[2] * least[2];
  if (squared >= best.squared) return;
  const std::uint8_t* tile = map_->tile(number_in(bricks_, brick));
  if (!tile) {
    Index3 at;
    for (int i = 0; i < 3; ++i) {
      const double voxel = (point[2 - i] - origin_[2 - i]) / spacing_[2 - i];
      at[i] = std::int64_t(std::clamp(voxel, double(first[i]), double(last[i])) + 0.5);
    }
    return best.take(squared, at);
  }
  double squares[2][brick_side];
  for (int axis = 0; axis < 2; ++axis)
    for (std::int64_t i = first[2 - axis]; i <= last[2 - axis]; ++i) {
      const double d = gap(axis, point[axis], i, i);
      squares[axis][i & 7] = d * d;
    }
  const auto& [x_squared, y_squared] = squares;
  const std::uint64_t numbers = 0x0101010101010101u * tissue_;
  for (std::int64_t z = first[0]; z <= last[0]; ++z) {
    const double dz = gap(2, point[2], z, z);
    if (dz * dz + least[1] * least[1] + least[2] * least[2] >= best.squared) continue;
    for (std::int64_t y = first[1]; y <= last[1]; ++y) {
      const double row = dz * dz + y_squared[y & 7];
      if (row + least[2] * least[2] >= best.squared) continue;
      const std::uint8_t* labels = tile + 64 * (z & 7) + 8 * (y & 7);
      if (!holds(labels, numbers)) continue;
      for (std::int64_t x = first[2]; x <= last[2]; ++x)
        if (labels[x & 7] == tissue_ && row + x_squared[x & 7] < best.squared)
          best.take(row + x_squared[x & 7], {z, y, x});
    }
  }
}

DistanceField::DistanceField(StructureSearch search, const Index3& shape, const float* estimate,
                             double spacing, const Vec3& origin, double error)
    : search_(std::move(search)), shape_(shape), spacing_(spacing), error_(error), origin_(origin) {
  require_positive("spacing", spacing);
  if (spacing > 0.4) refuse("spacing", "at most 0.4 mm", spacing);
  require_not_negative("error", error);
  require_finite("origin", origin);
  for (const std::int64_t n : shape)
    if (n < 2) refuse("every side of a field", "at least 2", double(n));
  const auto count = std::size_t(product(shape));
  values_ = std::make_unique<std::atomic<float>[]>(count);
  for (std::size_t i = 0; i < count; ++i) {
    const bool exact = estimate[i] - error < exact_to;
    values_[i].store(exact ? -1.0f - estimate[i] : estimate[i], std::memory_order_relaxed);
  }
}

float DistanceField::node(const Index3& at, NearestVoxel& nearest) const noexcept {
  std::atomic<float>& kept = values_[number_in(shape_, at)];
  float value = kept.load(std::memory_order_relaxed);
  if (value < 0.0f) {
    const Vec3 place = origin_ + spacing_ * Vec3(double(at[2]), double(at[1]), double(at[0]));
    const double estimate = -1.0 - double(value), rounded = 1e-6 * (1.0 + estimate);
    value = float(search_.distance(place, nearest, estimate + error_ + rounded));
    kept.store(value, std::memory_order_relaxed);
  }
  return value;
}

double DistanceField::at(const Vec3& point, NearestVoxel& nearest) const noexcept {
  const StandardArithmetic arithmetic;
  Index3 whole;
  double part[3];  // (z, y, x)
  for (int i = 0; i < 3; ++i) {
    const double place = (point[2 - i] - origin_[2 - i]) / spacing_;
    if (!(place >= 0.0 && place < double(shape_[i] - 1))) return std::numeric_limits<double>::infinity();
    whole[i] = std::int64_t(place);
    part[i] = place - double(whole[i]);
  }
  const auto along_x = [&](std::int64_t z, std::int64_t y) {
    const float first = node({z, y, whole[2]}, nearest);
    return first + part[2] * (double(node({z, y, whole[2] + 1}, nearest)) - first);
  };
  const auto along_y = [&](std::int64_t z) {
    const double first = along_x(z, whole[1]);
    return first + part[1] * (along_x(z, whole[1] + 1) - first);
  };
  const double first = along_y(whole[0]);
  return first + part[0] * (along_y(whole[0] + 1) - first);
}

double DistanceField::depth(const Vec3& point) const noexcept {
  double least = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    const double from = point[axis] - origin_[axis];
    least = std::min({least, from, spacing_ * double(shape_[2 - axis] - 1) - from});
  }
  return least;
}

double StructureDistance::of_sphere(const Vec3& center, double radius, NearestVoxel& nearest) const noexcept {
  const StandardArithmetic arithmetic;
  const double far = field_.at(center, nearest);
  return is_far(far - radius) ? far - radius : exact(center, far, nearest) - radius;
}

SphereDistance StructureDistance::around(const Vec3& center, double radius,
                                         NearestVoxel& nearest) const noexcept {
  const StandardArithmetic arithmetic;
  const double far = field_.at(center, nearest), depth = field_.depth(center);
  if (std::isinf(far)) return {far, 1.0, -depth};
  if (!is_far(far - radius)) {
    const double value = exact(center, far, nearest) - radius;
    return {value, 1.0, std::min(exact_below - value, depth)};  // above exact_below the field may be used
  }
  const double rate = DistanceField::steepest;
  const double near = far - radius - exact_below - field_.too_far(), beyond = field_.exact_at_most() - far;
  return {far - radius, rate, std::min({near / rate, beyond / rate, depth})};
}

double StructureDistance::exact(const Vec3& center, double far, NearestVoxel& nearest) const noexcept {
  return search().distance(center, nearest, far + field_.too_near());
}

bool StructureDistance::is_far(double value) const { return !(value < exact_below + field_.too_far()); }

}  // namespace burrlab
