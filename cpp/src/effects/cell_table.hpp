// Which parcels share a cell of a grid: a hash table of cells, filled and read in the order of the parcels,
// so that the outcome depends on nothing else.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "burrlab/types.hpp"

namespace burrlab {

class CellTable {
 public:
  static constexpr std::uint32_t none = 0xFFFFFFFFu;

  /// For cells of this edge [mm] and at most `most` entries; forgets all.
  void reset(double edge, std::size_t most) {
    per_mm_ = 1.0 / edge;
    std::size_t slots = 16;
    while (slots < 2 * most) slots *= 2;
    key_.assign(slots, 0);
    value_.assign(slots, none);
  }
  /// The entry of the cell of a place and of a kind 0..3, to be read and set; `none` where there is none yet.
  std::uint32_t& at(const Vec3& place, unsigned kind) {
    std::uint64_t key = 1 + kind;
    for (int axis = 0; axis < 3; ++axis) {
      const auto cell = static_cast<std::int64_t>(std::floor(place[axis] * per_mm_));
      key = key << 20 ^ (static_cast<std::uint64_t>(cell) & 0xFFFFFu);
    }
    const std::size_t mask = key_.size() - 1;
    std::size_t slot = static_cast<std::size_t>(key * 0x9E3779B97F4A7C15u >> 32) & mask;
    while (value_[slot] != none && key_[slot] != key) slot = (slot + 1) & mask;
    key_[slot] = key;
    return value_[slot];
  }

 private:
  double per_mm_ = 1.0;
  std::vector<std::uint64_t> key_;
  std::vector<std::uint32_t> value_;
};

}  // namespace burrlab
