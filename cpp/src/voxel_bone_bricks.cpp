// Bricks by number: what copies that follow a bone read, write and take over.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "burrlab/check.hpp"
#include "burrlab/voxel_bone.hpp"
#include "kernel/shared_rows.hpp"

namespace burrlab {

void VoxelBone::touch() {
  constexpr std::size_t page = 4096;
  for (Tiles* tiles : {&density_, &pristine_}) {
    if (tiles->empty()) continue;
    volatile std::uint8_t* first = tiles->tile(0);
    for (std::size_t i = 0; i < sums_.size() * brick_voxels; i += page) first[i] = first[i];
  }
}

std::vector<std::uint32_t> VoxelBone::bricks_between(const Vec3& low, const Vec3& high) const {
  Index3 first, last;
  for (int axis = 0; axis < 3; ++axis) {
    const double size = brick_side * spacing_[axis], begin = origin_[axis] - 0.5 * spacing_[axis];
    const auto most = double(bricks_[2 - axis] - 1);
    first[2 - axis] = std::int64_t(std::clamp(std::floor((low[axis] - begin) / size), 0.0, most + 1.0));
    last[2 - axis] = std::int64_t(std::clamp(std::floor((high[axis] - begin) / size), -1.0, most));
  }
  std::vector<std::uint32_t> numbers;
  for (std::int64_t z = first[0]; z <= last[0]; ++z)
    for (std::int64_t y = first[1]; y <= last[1]; ++y)
      for (std::int64_t x = first[2]; x <= last[2]; ++x)
        numbers.push_back(static_cast<std::uint32_t>(brick_number(z, y, x)));
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
  std::uint8_t before[brick_voxels];  // the tile may be where the pristine levels lie
  std::memcpy(before, pristine, brick_voxels);
  count_tissues(brick, -1);
  std::memcpy(density_.tile(brick), density, brick_voxels);
  settle(at, brick, before);
  count_tissues(brick, 1);
}

// Only the tile is read: all else follows from it and from what is known here.
void VoxelBone::copy_brick(std::size_t brick, const VoxelBone& from) {
  alignas(64) std::uint8_t levels[brick_voxels];
  load_shared_tile(levels, from.tile(brick));
  if (std::memcmp(levels, tile(brick), brick_voxels) == 0) return;
  const bool mixed = tissues_ && tissues_->tile(brick);
  if (mixed) tissues_->add(brick, tile(brick), -1, tissue_sums_.present);
  if (tissues_ && !mixed) tissue_sums_.present[tissues_->number(brick)] -= sums_[brick].mass;
  level_sum_ -= sums_[brick].mass;
  std::memcpy(open(brick), levels, brick_voxels);
  state_[brick] |= eroded | changed;
  sums_[brick] = sum_brick(tile(brick));
  level_sum_ += sums_[brick].mass;
  if (mixed) tissues_->add(brick, tile(brick), 1, tissue_sums_.present);
  if (tissues_ && !mixed) tissue_sums_.present[tissues_->number(brick)] += sums_[brick].mass;
  occupancy_.set(place(brick), sums_[brick].mass > 0);
}

}  // namespace burrlab
