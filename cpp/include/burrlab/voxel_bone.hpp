// Voxel bone: occupancy levels now and as loaded, on a regular grid.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "burrlab/types.hpp"

namespace burrlab {

/// Dense uint8 occupancy (z, y, x): 0 empty, 255 solid bone. Holds two levels a voxel, `density` q now and
/// `pristine` p as loaded or written; q <= p. Outside the volume there is nothing.
class VoxelBone {
 public:
  /// shape (z, y, x); spacing (x, y, z) [mm]; origin: centre of voxel (0, 0, 0), (x, y, z) [mm].
  VoxelBone(Index3 shape, std::vector<std::uint8_t> levels, const Vec3& spacing, const Vec3& origin);

  const Index3& shape() const { return shape_; }
  const Vec3& spacing() const { return spacing_; }
  const Vec3& origin() const { return origin_; }
  double voxel_volume() const { return spacing_.prod(); }  ///< [mm^3]

  const std::uint8_t* density() const { return density_.data(); }
  const std::uint8_t* pristine() const { return pristine_->data(); }
  std::shared_ptr<const std::vector<std::uint8_t>> shared_pristine() const { return pristine_; }

  double mass() const { return level_sum_ * (voxel_volume() / 255.0); }  ///< [mm^3 of solid bone]
  double removed() const;                                                ///< pristine minus present [mm^3]

  /// Sets q and p of the box that begins at `start` (z, y, x); throws if it leaves the volume.
  void write(const Index3& start, const Index3& shape, const std::uint8_t* levels);
  void reset();  ///< q = p everywhere

  /// 128 bits as 32 hexadecimal digits: geometry plus the sum over 8^3 bricks of a hash of brick index,
  /// q and p. A sum, so that a brick that changed can be exchanged in it.
  std::string digest() const;

  /// For the tick alone: levels to erode in place, and the number of levels it took.
  std::uint8_t* eroded() { return density_.data(); }
  void account(std::int64_t levels_lost) { level_sum_ -= levels_lost; }

 private:
  std::int64_t size() const { return shape_[0] * shape_[1] * shape_[2]; }

  Index3 shape_;
  Vec3 spacing_, origin_;
  std::vector<std::uint8_t> density_;
  std::shared_ptr<std::vector<std::uint8_t>> pristine_;  // shared between copies until one is written to
  std::int64_t level_sum_ = 0;
};

}  // namespace burrlab
