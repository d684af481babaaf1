#include "burrlab/tissues.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <set>

#include "brick_levels.hpp"
#include "brick_walk.hpp"
#include "kernel/kernel.hpp"
#include "require.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {

Tissues::Tissues(std::vector<Tissue> tissues, const Material& material)
    : tissues_(std::move(tissues)), material_(material) {
  const StandardArithmetic arithmetic;
  if (tissues_.empty() || tissues_.size() > most)
    refuse("number of tissues", "1 to " + std::to_string(most), double(tissues_.size()));
  std::set<std::string> names;
  std::set<std::int32_t> labels;
  for (std::size_t i = 0; i < tissues_.size(); ++i) {
    const Tissue& tissue = tissues_[i];
    if (tissue.name.empty()) throw InvalidArgument("name of a tissue must not be empty");
    if (!names.insert(tissue.name).second)
      throw InvalidArgument("names of tissues must differ, got '" + tissue.name + "' twice");
    if (tissue.label < 0) refuse("label of '" + tissue.name + "'", "zero or positive", tissue.label);
    if (!labels.insert(tissue.label).second) refuse("labels of tissues", "different", tissue.label);
    if (!(tissue.c_e >= 1.0 / quanta && tissue.c_e <= largest_c_e))
      refuse("c_e of '" + tissue.name + "'", "from 1/4096 to 1000 N/mm^2", tissue.c_e);
    require_not_negative("alpha of '" + tissue.name + "'", tissue.alpha);
    stiffness_[i] = static_cast<std::int32_t>(std::rint(tissue.c_e * quanta));
  }
  for (std::size_t i = 0; i < size(); ++i)
    for (std::size_t j = 0; j < size(); ++j)
      if (stiffness_[i] == stiffness_[j] && tissues_[i].alpha == tissues_[j].alpha)
        alike_[i] |= std::uint64_t{1} << j;
}

std::size_t Tissues::find(const std::string& name) const {
  const auto named = [&](const Tissue& tissue) { return tissue.name == name; };
  return std::size_t(std::find_if(tissues_.begin(), tissues_.end(), named) - tissues_.begin());
}

std::int32_t Tissues::largest_stiffness() const {
  return *std::max_element(stiffness_.begin(), stiffness_.end());
}

static const Index3& not_negative(const Index3& shape) {
  for (const std::int64_t side : shape)
    if (side < 0) refuse("side of a tissue map", "zero or positive", double(side));
  return shape;
}

TissueMap::TissueMap(const Index3& shape, const Tissues& table)
    : shape_(not_negative(shape)),
      bricks_(covering(shape, brick_side)),
      table_(table),
      number_(std::size_t(product(bricks_))),
      present_(number_.size()) {}

TissueMap::TissueMap(const Index3& shape, const std::uint8_t* packed, std::size_t size, const Tissues& table)
    : TissueMap(shape, table) {
  const auto tiles = packed_tiles(packed, size, number_.size());
  for (std::size_t brick = 0; brick < tiles.size(); ++brick) {
    const std::uint8_t* numbers = tiles[brick] ? tiles[brick] : packed + brick;
    number_[brick] = *numbers;
    for (int i = 0; i < (tiles[brick] ? brick_voxels : 1); ++i) {
      if (i > 0 && numbers[i] == numbers[i - 1]) continue;
      if (numbers[i] >= table.size())
        refuse("every tissue number", "below " + std::to_string(table.size()), numbers[i]);
      present_[brick] |= std::uint64_t{1} << numbers[i];
    }
    if (!mixed(brick)) continue;
    if (tiles_.empty()) tiles_ = Tiles(tiles.size());
    std::memcpy(tiles_.tile(brick), numbers, brick_voxels);
  }
}

std::vector<std::uint8_t> TissueMap::packed() const {
  std::vector<const std::uint8_t*> tiles(number_.size());
  for (std::size_t brick = 0; brick < tiles.size(); ++brick) tiles[brick] = tile(brick);
  return pack(number_, tiles);
}

TissueMap::TissueMap(const Index3& shape, const std::uint8_t* numbers, const Tissues& table)
    : TissueMap(shape, table) {
  const std::int64_t voxels = product(shape);
  const std::uint8_t largest = voxels ? *std::max_element(numbers, numbers + voxels) : 0;
  if (largest >= table.size())
    refuse("every tissue number", "below " + std::to_string(table.size()), largest);
  each_brick(bricks_, {0, 0, 0}, shape, [&](const Index3& at, std::size_t brick) {
    std::uint8_t tile[brick_voxels];
    number_[brick] = numbers[number_in(shape, {8 * at[0], 8 * at[1], 8 * at[2]})];
    std::memset(tile, number_[brick], sizeof tile);
    each_row(at, {0, 0, 0}, shape, [&](std::int64_t in_tile, std::int64_t in_box, std::size_t length) {
      std::memcpy(tile + in_tile, numbers + in_box, length);
    });
    for (const std::uint8_t number : tile) present_[brick] |= std::uint64_t{1} << number;
    if (!mixed(brick)) return;
    if (tiles_.empty()) tiles_ = Tiles(number_.size());
    std::memcpy(tiles_.tile(brick), tile, sizeof tile);
  });
}

void TissueMap::read(const Index3& start, const Index3& shape, std::uint8_t* out) const {
  each_brick(bricks_, start, shape, [&](const Index3& at, std::size_t brick) {
    const std::uint8_t* numbers = tile(brick);
    each_row(at, start, shape, [&](std::int64_t in_tile, std::int64_t in_box, std::size_t length) {
      if (numbers)
        std::memcpy(out + in_box, numbers + in_tile, length);
      else
        std::memset(out + in_box, number_[brick], length);
    });
  });
}

// Calls take(number, levels of that tissue). The first voxel's tissue has what the others leave.
template <class Take>
void TissueMap::by_tissue(std::size_t brick, const std::uint8_t* levels, std::int64_t sum, Take take) const {
  const auto sum_where = kernel::current_kernel().sum_where;
  std::uint64_t others = present_[brick] & ~(std::uint64_t{1} << number_[brick]);
  for (; others; others &= others - 1) {
    const auto number = static_cast<std::uint8_t>(lowest_bit(others));
    const std::int64_t here = sum_where(levels, tiles_.tile(brick), number);
    take(number, here);
    sum -= here;
  }
  take(number_[brick], sum);
}

void TissueMap::add(std::size_t brick, const std::uint8_t* levels, std::int64_t sum, int sign,
                    Sums& sums) const {
  by_tissue(brick, levels, sum, [&](std::size_t number, std::int64_t here) { sums[number] += sign * here; });
}

std::int64_t TissueMap::stiffness_sum(std::size_t brick, const std::uint8_t* levels, std::int64_t sum) const {
  std::int64_t weighed = 0;
  by_tissue(brick, levels, sum,
            [&](std::size_t number, std::int64_t here) { weighed += table_.stiffness(number) * here; });
  return weighed;
}

}  // namespace burrlab
