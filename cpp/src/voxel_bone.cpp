#include "burrlab/voxel_bone.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "brick_levels.hpp"
#include "kernel/shared_rows.hpp"
#include "require.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {

static Index3 checked(const Index3& shape, const Vec3& spacing, const Vec3& origin) {
  for (int axis = 0; axis < 3; ++axis) {
    if (shape[axis] < 1) refuse("every side of the volume", "at least one voxel", double(shape[axis]));
    require_positive("spacing", spacing[axis]);
    require_finite("origin", origin[axis]);
    if (spacing[axis] < 1e-6 || spacing[axis] > 1e6) refuse("spacing", "1e-6 to 1e6 mm", spacing[axis]);
    if (std::abs(origin[axis]) > 1e9) refuse("origin", "within 1e9 mm", origin[axis]);
  }
  const double columns = double(shape[0]) * double((shape[1] + 7) / 8) * double(shape[2]);
  if (columns >= 4294967296.0) refuse("voxels / 8 of the volume", "below 2^32", columns);
  return shape;
}

VoxelBone::VoxelBone(const Index3& shape, const Vec3& spacing, const Vec3& origin)
    : shape_(checked(shape, spacing, origin)),
      bricks_(covering(shape, brick_side)),
      spacing_(spacing),
      origin_(origin + Vec3::Zero()),  // no minus zero
      occupancy_(bricks_) {}

VoxelBone::VoxelBone(const Index3& shape, const Levels& levels, const Vec3& spacing, const Vec3& origin)
    : VoxelBone(shape, 0, spacing, origin) {
  if (std::int64_t(levels.size()) != product(shape_)) throw InvalidArgument("levels do not fill the shape");
  write({0, 0, 0}, shape_, levels.data());
}

VoxelBone::VoxelBone(const Index3& shape, std::uint8_t level, const Vec3& spacing, const Vec3& origin)
    : VoxelBone(shape, spacing, origin) {
  const auto count = static_cast<std::size_t>(product(bricks_));
  density_ = Tiles(count);
  versions_ = std::make_shared<BrickVersions>(count);
  sums_.resize(count);
  level_.resize(count, level);
  state_.resize(count, level > 0 && level < 32 ? uniform | faint : uniform);
  level_sum_ = pristine_sum_ = product(shape_) * level;
  if (level == 0) return;
  each_brick(bricks_, {0, 0, 0}, shape_, [&](const Index3& at, std::size_t brick) {
    copy_pristine(at, brick, density_.tile(brick));
    sums_[brick] = sum_brick(tile(brick));
    occupancy_.set(at, true);
  });
}

VoxelBone::VoxelBone(const Index3& shape, const std::uint8_t* packed, std::size_t size, const Vec3& spacing,
                     const Vec3& origin)
    : VoxelBone(shape, 0, spacing, origin) {
  const auto tiles = packed_tiles(packed, size, sums_.size());
  each_brick(bricks_, {0, 0, 0}, shape_, [&](const Index3& at, std::size_t brick) {
    state_[brick] |= changed;  // as after `write`
    level_[brick] = packed[brick];
    if (!tiles[brick] && !packed[brick]) return;
    std::uint8_t pristine[brick_voxels];
    if (tiles[brick])
      std::memcpy(pristine, tiles[brick], brick_voxels);
    else
      copy_pristine(at, brick, pristine);
    std::memcpy(density_.tile(brick), pristine, brick_voxels);
    update_brick(at, brick, pristine);
  });
}

VoxelBone::VoxelBone(const VoxelBone& other)
    : shape_(other.shape_),
      bricks_(other.bricks_),
      spacing_(other.spacing_),
      origin_(other.origin_),
      density_(other.sums_.size()),
      versions_(std::make_shared<BrickVersions>(other.sums_.size())),
      sums_(other.sums_),
      level_(other.level_),
      state_(other.state_),
      occupancy_(other.occupancy_),
      level_sum_(other.level_sum_),
      pristine_sum_(other.pristine_sum_),
      tissues_(other.tissues_),
      tissue_sums_(other.tissue_sums_) {
  if (!other.pristine_.empty()) pristine_ = Tiles(sums_.size());
  for (std::size_t brick = 0; brick < sums_.size(); ++brick) {
    if (sums_[brick].mass) std::memcpy(density_.tile(brick), other.tile(brick), brick_voxels);
    if (state_[brick] & saved) std::memcpy(pristine_.tile(brick), other.pristine_.tile(brick), brick_voxels);
  }
}

void VoxelBone::refuse_use(int users) {
  const std::string rule = "bone must be used by one thread alone while it is changed: another thread ";
  throw InvalidArgument(rule + (users < 0 ? "changes it" : "reads it"));
}

double VoxelBone::voxel_volume() const { return spacing_.prod(); }

double VoxelBone::volume_of(std::int64_t levels) const { return double(levels) * (voxel_volume() / 255.0); }

double VoxelBone::mass() const {
  const StandardArithmetic arithmetic;
  return volume_of(level_sum_);
}

double VoxelBone::removed() const {
  const StandardArithmetic arithmetic;
  return volume_of(pristine_sum_ - level_sum_);
}

std::size_t VoxelBone::hierarchy_bytes() const {
  return sums_.size() * (sizeof(BrickSums) + sizeof level_[0] + sizeof state_[0]) + occupancy_.bytes() +
         (tissues_ ? tissues_->hierarchy_bytes() : 0);
}

Index3 VoxelBone::extent(const Index3& at) const {
  Index3 n;
  for (int axis = 0; axis < 3; ++axis)
    n[axis] = std::min<std::int64_t>(brick_side, shape_[axis] - brick_side * at[axis]);
  return n;
}

void VoxelBone::check_box(const Index3& start, const Index3& shape) const {
  for (int axis = 0; axis < 3; ++axis) {
    if (start[axis] < 0 || shape[axis] < 0 || start[axis] > shape_[axis] ||
        shape[axis] > shape_[axis] - start[axis]) {
      throw InvalidArgument("values must lie inside the volume: along axis " + std::to_string(axis) +
                            " (z, y, x) " + std::to_string(shape[axis]) + " voxels from " +
                            std::to_string(start[axis]) + " of " + std::to_string(shape_[axis]));
    }
  }
}

// Copies the pristine tile, zeros beyond the volume.
void VoxelBone::copy_pristine(const Index3& at, std::size_t brick, std::uint8_t* tile) const {
  if (const std::uint8_t* known = pristine_tile(brick)) {
    if (known != tile) std::memcpy(tile, known, brick_voxels);
    return;
  }
  const Index3 n = extent(at);
  const bool whole = product(n) == brick_voxels;
  std::memset(tile, whole ? level_[brick] : 0, brick_voxels);
  if (whole) return;
  for (std::int64_t z = 0; z < n[0]; ++z)
    for (std::int64_t y = 0; y < n[1]; ++y)
      std::memset(tile + (z * brick_side + y) * brick_side, level_[brick], std::size_t(n[2]));
}

// Updates all that follows from a brick's present and pristine levels.
void VoxelBone::update_brick(const Index3& at, std::size_t brick, const std::uint8_t* pristine) {
  const std::int64_t pristine_before = pristine_mass(at, brick), before = sums_[brick].mass;
  const Index3 n = extent(at);
  unsigned other = 0, some_faint = 0;
  const auto look = [&](const std::uint8_t* p, std::int64_t count) {
    for (std::int64_t i = 0; i < count; ++i) {
      other |= static_cast<unsigned>(p[i] ^ pristine[0]);
      some_faint |= static_cast<std::uint8_t>(p[i] - 1) < 31;
    }
  };
  if (product(n) == brick_voxels) {
    look(pristine, brick_voxels);
  } else {
    for (std::int64_t z = 0; z < n[0]; ++z)
      for (std::int64_t y = 0; y < n[1]; ++y) look(pristine + (z * brick_side + y) * brick_side, n[2]);
  }
  const bool differs = std::memcmp(pristine, tile(brick), brick_voxels) != 0;
  state_[brick] = static_cast<std::uint8_t>(changed | (differs ? eroded : 0) | (some_faint ? faint : 0));
  if (!other) {
    state_[brick] |= uniform;
    level_[brick] = pristine[0];
  } else {
    if (pristine_.empty()) pristine_ = Tiles(sums_.size());
    if (differs) {
      std::memcpy(pristine_.tile(brick), pristine, brick_voxels);
      state_[brick] |= saved;
    }
  }
  sums_[brick] = sum_brick(tile(brick));
  // at once, as other threads ask for the sums
  level_sum_ += std::int64_t(sums_[brick].mass) - before;
  pristine_sum_ += pristine_mass(at, brick) - pristine_before;
  occupancy_.set(at, sums_[brick].mass > 0);
}

std::int64_t VoxelBone::pristine_mass(const Index3& at, std::size_t brick) const {
  if (!(state_[brick] & eroded)) return sums_[brick].mass;
  return state_[brick] & uniform ? product(extent(at)) * level_[brick]
                                 : sum_brick(pristine_.tile(brick)).mass;
}

void VoxelBone::read(const Index3& start, const Index3& shape, bool pristine, std::uint8_t* out) const {
  check_box(start, shape);
  each_brick(bricks_, start, shape, [&](const Index3& at, std::size_t brick) {
    std::uint8_t levels[brick_voxels];
    if (pristine) copy_pristine(at, brick, levels);
    const std::uint8_t* from = pristine ? levels : tile(brick);
    each_row(at, start, shape, [&](std::int64_t in_tile, std::int64_t in_box, std::size_t length) {
      std::memcpy(out + in_box, from + in_tile, length);
    });
  });
}

VoxelBone::Levels VoxelBone::read(const Index3& start, const Index3& shape, bool pristine) const {
  check_box(start, shape);
  Levels out(static_cast<std::size_t>(product(shape)));
  read(start, shape, pristine, out.data());
  return out;
}

// Sets the present levels of a brick, and nothing that follows from them.
void VoxelBone::set_tile(std::size_t brick, const std::uint8_t* levels) {
  versions_->begin(brick);
  for (int row = 0; row < brick_voxels; row += brick_side) {
    std::uint64_t image;
    std::memcpy(&image, levels + row, sizeof image);
    store_row(density_.tile(brick) + row, image);
  }
  versions_->end(brick, true);
}

// Sets the present levels of a box that lies inside, and the pristine ones to the same.
void VoxelBone::set_box(const Index3& start, const Index3& shape, const std::uint8_t* levels,
                        bool pristine_too) {
  each_brick(bricks_, start, shape, [&](const Index3& at, std::size_t brick) {
    std::uint8_t density[brick_voxels], pristine[brick_voxels];
    std::memcpy(density, tile(brick), brick_voxels);
    copy_pristine(at, brick, pristine);
    count_tissues(brick, -1);
    each_row(at, start, shape, [&](std::int64_t in_tile, std::int64_t in_box, std::size_t length) {
      if (pristine_too) std::memcpy(pristine + in_tile, levels + in_box, length);
      std::memcpy(density + in_tile, levels + in_box, length);
    });
    if (pristine_too || std::memcmp(density, tile(brick), brick_voxels) != 0) {
      set_tile(brick, density);
      update_brick(at, brick, pristine);
    }
    count_tissues(brick, 1);
  });
}

void VoxelBone::write(const Index3& start, const Index3& shape, const std::uint8_t* levels) {
  check_box(start, shape);
  set_box(start, shape, levels, true);
}

VoxelBone::Levels VoxelBone::packed() const {
  std::vector<const std::uint8_t*> tiles(sums_.size());
  for (std::size_t brick = 0; brick < tiles.size(); ++brick) tiles[brick] = pristine_tile(brick);
  return pack(level_, tiles);
}

void VoxelBone::restore(const std::uint8_t* density) {
  const Changing changing(*this);
  const Levels before = pristine();
  for (std::size_t i = 0; i < before.size(); ++i) {
    if (density[i] > before[i])
      throw InvalidArgument("density must be at most the pristine level, got " + std::to_string(density[i]) +
                            " over " + std::to_string(before[i]));
  }
  set_box({0, 0, 0}, shape_, density, false);
}

void VoxelBone::reset() {
  const Changing changing(*this);
  each_brick(bricks_, {0, 0, 0}, shape_, [&](const Index3& at, std::size_t brick) {
    if (!(state_[brick] & eroded)) return;
    count_tissues(brick, -1);
    std::uint8_t pristine[brick_voxels];
    copy_pristine(at, brick, pristine);
    set_tile(brick, pristine);
    state_[brick] = static_cast<std::uint8_t>((state_[brick] & ~eroded) | changed);
    sums_[brick] = sum_brick(tile(brick));
    occupancy_.set(at, sums_[brick].mass > 0);
    count_tissues(brick, 1);
  });
  level_sum_ = pristine_sum_;
}

std::uint8_t* VoxelBone::open(std::size_t brick) {
  if (!(state_[brick] & (uniform | saved))) {
    std::memcpy(pristine_.tile(brick), tile(brick), brick_voxels);
    state_[brick] |= saved;
  }
  versions_->begin(brick);
  return density_.tile(brick);
}

std::int64_t VoxelBone::close(const Index3& at, std::size_t brick, const BrickSums& now,
                              std::uint8_t* before) {
  const std::int64_t lost = std::int64_t(sums_[brick].mass) - now.mass;
  versions_->end(brick, lost != 0);
  if (lost == 0) return 0;
  sums_[brick] = now;
  state_[brick] |= eroded | changed;
  level_sum_ -= lost;
  if (now.mass == 0) occupancy_.set(at, false);
  if (tissues_) {
    const std::uint8_t* after = tile(brick);
    if (tissues_->tile(brick))
      for (int i = 0; i < brick_voxels; ++i) before[i] = static_cast<std::uint8_t>(before[i] - after[i]);
    tissues_->add(brick, before, lost, -1, tissue_sums_.present);
  }
  return lost;
}

// Bricks by number, for copies that follow a bone.

void VoxelBone::write_pages() {
  constexpr std::size_t page = 4096;
  for (Tiles* tiles : {&density_, &pristine_}) {
    if (tiles->empty()) continue;
    for (std::size_t i = 0; i < sums_.size() * brick_voxels; i += page)
      store_row(tiles->tile(0) + i, load_shared_row(tiles->tile(0) + i));
  }
}

std::vector<std::uint32_t> VoxelBone::bricks_between(const Vec3& low, const Vec3& high) const {
  if (!(low.array() <= high.array()).all()) return {};  // NaN too
  Index3 first, last;
  for (int axis = 0; axis < 3; ++axis) {
    const double size = brick_side * spacing_[axis], begin = origin_[axis] - 0.5 * spacing_[axis];
    const auto most = double(bricks_[2 - axis] - 1);
    first[2 - axis] = std::int64_t(std::clamp(std::floor((low[axis] - begin) / size), 0.0, most + 1.0));
    last[2 - axis] = std::int64_t(std::clamp(std::floor((high[axis] - begin) / size), -1.0, most));
  }
  std::vector<std::uint32_t> numbers;
  each_place(first, last,
             [&](const Index3& at) { numbers.push_back(std::uint32_t(number_in(bricks_, at))); });
  return numbers;
}

std::vector<std::uint32_t> VoxelBone::take_changed() {
  std::vector<std::uint32_t> numbers;
  for (std::size_t brick = 0; brick < state_.size(); ++brick) {
    if (!(state_[brick] & changed)) continue;
    state_[brick] &= static_cast<std::uint8_t>(~changed);
    numbers.push_back(static_cast<std::uint32_t>(brick));
  }
  return numbers;
}

void VoxelBone::read_brick(std::size_t brick, std::uint8_t* density, std::uint8_t* pristine) const {
  std::memcpy(density, tile(brick), brick_voxels);
  copy_pristine(place(brick), brick, pristine);
}

void VoxelBone::write_brick(std::size_t brick, const std::uint8_t* density, const std::uint8_t* pristine) {
  if (brick >= sums_.size()) refuse("brick", "below " + std::to_string(sums_.size()), double(brick));
  const Index3 at = place(brick), n = extent(at);
  for (int i = 0; i < brick_voxels; ++i) {
    const bool inside = i / 64 < n[0] && i / 8 % 8 < n[1] && i % 8 < n[2];
    if (density[i] > pristine[i]) refuse("density of a brick", "at most its pristine level", density[i]);
    if (!inside && pristine[i]) refuse("levels of a brick beyond the volume", "0", pristine[i]);
  }
  std::uint8_t before[brick_voxels];  // the tile may hold the pristine levels
  std::memcpy(before, pristine, brick_voxels);
  count_tissues(brick, -1);
  set_tile(brick, density);
  update_brick(at, brick, before);
  count_tissues(brick, 1);
}

// Reads only the other bone's tile; all else follows from the tile and this bone.
void VoxelBone::copy_brick(std::size_t brick, const VoxelBone& from) {
  alignas(64) std::uint8_t levels[brick_voxels];
  load_shared_tile(levels, from.tile(brick));
  if (std::memcmp(levels, tile(brick), brick_voxels) == 0) return;
  if (tissues_) tissues_->add(brick, tile(brick), sums_[brick].mass, -1, tissue_sums_.present);
  level_sum_ -= sums_[brick].mass;
  open(brick);
  set_tile(brick, levels);
  state_[brick] |= eroded | changed;
  sums_[brick] = sum_brick(tile(brick));
  level_sum_ += sums_[brick].mass;
  if (tissues_) tissues_->add(brick, tile(brick), sums_[brick].mass, 1, tissue_sums_.present);
  occupancy_.set(place(brick), sums_[brick].mass > 0);
}

void VoxelBone::set_tissues(std::shared_ptr<const TissueMap> map) {
  if (map && map->shape() != shape_)
    throw InvalidArgument("numbers of tissues must have the shape of the bone");
  const Changing changing(*this);
  tissues_ = std::move(map);
  tissue_sums_ = {};
  for (std::size_t brick = 0; brick < sums_.size(); ++brick) count_tissues(brick, 1);
}

std::vector<std::int64_t> VoxelBone::tissue_levels() const {
  const auto& present = tissue_sums_.present;
  return {present.begin(), present.begin() + std::int64_t(tissues_ ? tissues_->table().size() : 0)};
}

double VoxelBone::removed_of(std::size_t tissue) const {
  return volume_of(tissue_sums_.pristine[tissue] - tissue_levels(tissue));
}

// Adds the brick's levels to the sums of its tissues, or subtracts them.
void VoxelBone::count_tissues(std::size_t brick, int sign) {
  if (!tissues_) return;
  const Index3 at = place(brick);
  alignas(64) std::uint8_t pristine[brick_voxels];
  if (tissues_->tile(brick)) copy_pristine(at, brick, pristine);
  tissues_->add(brick, tile(brick), sums_[brick].mass, sign, tissue_sums_.present);
  tissues_->add(brick, pristine, pristine_mass(at, brick), sign, tissue_sums_.pristine);
}

}  // namespace burrlab
