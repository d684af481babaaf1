// Tissues: what the labels of a segmentation stand for, and the table of tissues of a bone.
//
//     burrlab::Tissue cortex{"cortex", 1, 0.9, 0.05}, nerve{"facial nerve", 2, 0.2, 0.2};
//     const burrlab::Tissues table({cortex, nerve}, burrlab::paper_material("bone"));
//     bone->set_tissues(std::make_shared<burrlab::TissueMap>(bone->shape(), numbers.data(), table));
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "burrlab/brick.hpp"
#include "burrlab/material.hpp"
#include "burrlab/types.hpp"

namespace burrlab {

/// A row of the table.
struct Tissue {
  std::string name;                      ///< not empty
  std::int32_t label = 0;                ///< in the volume it was loaded from
  double c_e = 0.0;                      ///< elastic constant [N/mm^2], Eq. 3
  double alpha = 0.0;                    ///< erosion rate [1/ms], Eq. 4
  std::array<std::uint8_t, 3> colour{};  ///< red, green, blue
  bool critical = false;                 ///< distances to it and injuries of it are watched
  bool bleeds = false;                   ///< it bleeds where it is opened
  bool assumed = false;                  ///< c_e and alpha were not measured on this tissue
};

/// A table of tissues. A tissue's number is its place in the table. All share the f and the exponents of
/// `material`, which also gives c_e and alpha to tissues without their own.
class BURRLAB_API Tissues {
 public:
  static constexpr std::size_t most = 64;        ///< in a table
  static constexpr double quanta = 4096.0;       ///< c_e counts in 1/4096 N/mm^2, so that sums are exact
  static constexpr double largest_c_e = 1000.0;  ///< [N/mm^2]

  /// Throws InvalidArgument unless there are 1 to 64 tissues, names and labels differ, c_e is 1/4096 to 1000
  /// N/mm^2 and alpha zero or positive.
  Tissues(std::vector<Tissue> tissues, const Material& material);

  std::size_t size() const { return tissues_.size(); }  ///< number of tissues
  const Tissue& operator[](std::size_t number) const { return tissues_[number]; }
  const std::vector<Tissue>& all() const { return tissues_; }  ///< by number
  std::size_t find(const std::string& name) const;             ///< its number; `size()` if there is none
  const Material& material() const { return material_; }       ///< its f and exponents hold for all
  /// c_e of a tissue, rounded to nearest [1/4096 N/mm^2].
  std::int32_t stiffness(std::size_t number) const { return stiffness_[number]; }
  /// `stiffness` by number, `most` of them; zeros from `size()` on.
  const std::int32_t* stiffnesses() const { return stiffness_.data(); }
  std::int32_t largest_stiffness() const;  ///< in the table
  /// Bit i: tissue i has the same stiffness and alpha.
  std::uint64_t same_constants(std::size_t number) const { return alike_[number]; }

 private:
  std::vector<Tissue> tissues_;
  Material material_;
  std::array<std::int32_t, most> stiffness_{};
  std::array<std::uint64_t, most> alike_{};
};

/// Tissue numbers of a bone: one per voxel, or one per brick that is uniform. Never changes, so copies of a
/// bone share it.
class BURRLAB_API TissueMap {
 public:
  using Sums = std::array<std::int64_t, Tissues::most>;  ///< by tissue

  /// Numbers (z, y, x) into the table; throws InvalidArgument if one is not in the table.
  TissueMap(const Index3& shape, const std::uint8_t* numbers, const Tissues& table);
  /// With the numbers that `packed` returned; throws as above, or if they do not fill the shape.
  TissueMap(const Index3& shape, const std::uint8_t* packed, std::size_t size, const Tissues& table);
  std::vector<std::uint8_t> packed() const;  ///< numbers in few bytes, by `pack`

  const Tissues& table() const { return table_; }  ///< what the numbers mean
  const Index3& shape() const { return shape_; }   ///< voxels (z, y, x)
  /// Dense copy of a box, (z, y, x), that lies inside.
  void read(const Index3& start, const Index3& shape, std::uint8_t* out) const;

  /// @cond tick
  // Bricks by number, as in VoxelBone.
  /// 512 numbers (z, y, x), aligned to a cache line; null if all are `number(brick)`.
  const std::uint8_t* tile(std::size_t brick) const { return mixed(brick) ? tiles_.tile(brick) : nullptr; }
  std::uint8_t number(std::size_t brick) const { return number_[brick]; }  ///< of the first voxel
  /// Bit i: the brick holds tissue i.
  std::uint64_t present(std::size_t brick) const { return present_[brick]; }
  /// Whether the brick's tissues differ in stiffness or alpha.
  bool varies(std::size_t brick) const { return present_[brick] & ~table_.same_constants(number_[brick]); }
  // Of a brick's levels, aligned to a cache line and read if it is mixed, with their sum:
  /// Adds sign times those of each tissue to its sum.
  void add(std::size_t brick, const std::uint8_t* levels, std::int64_t sum, int sign, Sums& sums) const;
  /// Sum of K q.
  std::int64_t stiffness_sum(std::size_t brick, const std::uint8_t* levels, std::int64_t sum) const;

  std::size_t hierarchy_bytes() const { return number_.size() * (sizeof number_[0] + sizeof present_[0]); }
  /// @endcond

 private:
  TissueMap(const Index3& shape, const Tissues& table);
  bool mixed(std::size_t brick) const { return (present_[brick] & (present_[brick] - 1)) != 0; }
  template <class Take>
  void by_tissue(std::size_t brick, const std::uint8_t* levels, std::int64_t sum, Take take) const;

  Index3 shape_, bricks_;
  Tissues table_;
  std::vector<std::uint8_t> number_;
  std::vector<std::uint64_t> present_;
  Tiles tiles_;  // mixed bricks only; beyond the volume, the number of the brick's first voxel
};

}  // namespace burrlab
