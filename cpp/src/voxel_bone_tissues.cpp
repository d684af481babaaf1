// The tissues of a bone, and the sums of its levels by tissue.
#include <stdexcept>
#include <utility>

#include "burrlab/voxel_bone.hpp"

namespace burrlab {

void VoxelBone::set_tissues(std::shared_ptr<const TissueMap> map) {
  if (map && map->shape() != shape_)
    throw std::invalid_argument("numbers of tissues must have the shape of the bone");
  const Changing changing(*this);
  tissues_ = std::move(map);
  tissue_sums_ = {};
  for (std::size_t brick = 0; brick < sums_.size(); ++brick) count_tissues(brick, 1);
}

double VoxelBone::mass_of(std::size_t tissue) const {
  return double(tissue_levels(tissue)) * (voxel_volume() / 255.0);
}

double VoxelBone::removed_of(std::size_t tissue) const {
  return double(tissue_sums_.pristine[tissue] - tissue_levels(tissue)) * (voxel_volume() / 255.0);
}

// Adds the brick's levels to the sums of its tissues, or takes them out.
void VoxelBone::count_tissues(std::size_t brick, int sign) {
  if (!tissues_) return;
  if (!tissues_->tile(brick)) {
    const std::size_t tissue = tissues_->number(brick);
    tissue_sums_.present[tissue] += sign * std::int64_t(sums_[brick].mass);
    tissue_sums_.pristine[tissue] += sign * pristine_mass(place(brick), brick);
    return;
  }
  alignas(64) std::uint8_t pristine[brick_voxels];
  copy_pristine(place(brick), brick, pristine);
  tissues_->add(brick, tile(brick), sign, tissue_sums_.present);
  tissues_->add(brick, pristine, sign, tissue_sums_.pristine);
}

}  // namespace burrlab
