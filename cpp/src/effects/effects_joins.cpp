// Parcels that become one: dust that is wetted, and neighbours where there are too many.
#include "burrlab/effects/effects.hpp"
#include "cell_table.hpp"

namespace burrlab {

void Effects::wet() {
  const double saturation = setup_.parameters.paste_saturation;
  const auto has_room = [&](std::size_t i) {
    return double(parcels_.mass[i][dust]) < saturation * double(parcels_.liquid(i));
  };
  cells_->reset(setup_.parameters.wetting_distance, parcels_.size());
  bool any = false;
  for (std::size_t i = 0; i < parcels_.size(); ++i) {
    if (!has_room(i)) continue;
    std::uint32_t& known = cells_->at(parcels_.position[i], 0);
    if (known == CellTable::none) known = std::uint32_t(i);
    any = true;
  }
  if (!any) return;
  for (std::size_t i = 0; i < parcels_.size(); ++i) {
    if (parcels_.mass[i][dust] == 0 || !parcels_.dry(i)) continue;
    const std::uint32_t wetting = cells_->at(parcels_.position[i], 0);
    if (wetting != CellTable::none && has_room(wetting)) parcels_.merge(wetting, i);
  }
}

// Parcels of a kind in one cell become one; cells grow until it is enough. Dry and wet stay apart, which
// leaves at most 16: eight cells meet at the origin.
void Effects::merge_to(std::int64_t most) {
  for (double edge = setup_.parameters.merge_distance; std::int64_t(parcels_.size()) > most; edge *= 2.0) {
    cells_->reset(edge, parcels_.size());
    auto left = std::int64_t(parcels_.size());
    for (std::size_t i = 0; i < parcels_.size() && left > most; ++i) {
      std::uint32_t& known = cells_->at(parcels_.position[i], parcels_.dry(i) ? 1 : 0);
      if (known == CellTable::none) {
        known = std::uint32_t(i);
        continue;
      }
      parcels_.merge(known, i);
      --left;
      ++counts_.merged;
    }
    parcels_.compact();
  }
}

}  // namespace burrlab
