#include "burrlab/bone_view.hpp"

#include <algorithm>

#include "kernel/shared_rows.hpp"

namespace burrlab {

BoneView::BoneView(const VoxelBone& bone)
    : bricks_(bone.bricks()),
      tiles_(bone.density_.share()),
      versions_(bone.versions_),
      seen_(bone.brick_count(), 1),
      seen_group_(versions_->group.size(), ~std::uint64_t{0}),
      solid_(seen_.size() * brick_voxels / 8) {}

void BoneView::update(Changes& changes) {
  changes.bricks.clear();
  changes.levels.clear();
  for (auto* places : {&changes.places, &changes.opened, &changes.filled}) places->clear();
  read_all(&changes);
}

void BoneView::read_all(Changes* changes) {
  for (std::size_t group = 0; group < seen_group_.size(); ++group) {
    const std::uint64_t count = versions_->group[group].load(std::memory_order_acquire);
    if (count == seen_group_[group]) continue;
    const std::size_t first = group * BrickVersions::fan;
    const std::size_t end = std::min(first + BrickVersions::fan, seen_.size());
    bool complete = true;
    for (std::size_t brick = first; brick < end; ++brick) complete &= read(brick, changes);
    if (complete) seen_group_[group] = count;
  }
}

// Adds a brick if it changed; null: passes over it. Returns false if it was being written in every try.
bool BoneView::read(std::size_t brick, Changes* changes) {
  const std::atomic<std::uint32_t>& version = versions_->brick[brick];
  alignas(64) std::uint8_t levels[brick_voxels];
  std::uint32_t before = 0;
  for (int tries = 0;; ++tries) {
    if (tries == 16) return false;
    before = version.load(std::memory_order_acquire);
    if (before & 1) continue;
    if (before == seen_[brick]) return true;
    load_shared_tile(levels, tiles_.get() + brick * brick_voxels);
    std::atomic_thread_fence(std::memory_order_acquire);
    if (version.load(std::memory_order_relaxed) == before) break;
  }
  const bool known = !(seen_[brick] & 1);
  seen_[brick] = before;
  if (!known && std::all_of(levels, levels + brick_voxels, [](auto q) { return q == 0; })) return true;

  const Index3 at = place_in(bricks_, std::int64_t(brick));
  const Index3 first{brick_side * at[0], brick_side * at[1], brick_side * at[2]};
  if (changes) {
    changes->bricks.push_back(std::uint32_t(brick));
    changes->places.push_back(first);
    changes->levels.insert(changes->levels.end(), levels, levels + brick_voxels);
  }
  for (int row = 0; row < 64; ++row) {
    unsigned now = 0;
    for (int x = 0; x < 8; ++x) now |= unsigned(levels[8 * row + x] >= solid_level) << x;
    std::uint8_t& solid = solid_[64 * brick + std::size_t(row)];
    const unsigned differing = known && changes ? now ^ solid : 0;
    for (int x = 0; differing >> x; ++x)
      if (differing >> x & 1)
        (now >> x & 1 ? changes->filled : changes->opened)
            .push_back({first[0] + row / 8, first[1] + row % 8, first[2] + x});
    solid = static_cast<std::uint8_t>(now);
  }
  return true;
}

}  // namespace burrlab
