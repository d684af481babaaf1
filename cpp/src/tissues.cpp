#include "burrlab/tissues.hpp"

#include <algorithm>
#include <cmath>
#include <set>

namespace burrlab {

Tissues::Tissues(std::vector<Tissue> tissues, const Material& material)
    : tissues_(std::move(tissues)), material_(material) {
  if (tissues_.empty() || tissues_.size() > most)
    refuse("number of tissues", "1 to " + std::to_string(most), double(tissues_.size()));
  std::set<std::string> names;
  std::set<std::int32_t> labels;
  for (std::size_t i = 0; i < tissues_.size(); ++i) {
    const Tissue& tissue = tissues_[i];
    if (tissue.name.empty()) throw std::invalid_argument("name of a tissue must not be empty");
    if (!names.insert(tissue.name).second)
      throw std::invalid_argument("names of tissues must differ, got '" + tissue.name + "' twice");
    if (tissue.label < 0) refuse("label of '" + tissue.name + "'", "zero or positive", tissue.label);
    if (!labels.insert(tissue.label).second) refuse("labels of tissues", "different", tissue.label);
    if (!(tissue.c_e >= 1.0 / quanta && tissue.c_e <= largest_c_e))
      refuse("c_e of '" + tissue.name + "'", "from 1/4096 to 1000 N/mm^2", tissue.c_e);
    require_not_negative("alpha of '" + tissue.name + "'", tissue.alpha);
    stiffness_[i] = static_cast<std::int32_t>(std::rint(tissue.c_e * quanta));
  }
}

std::int32_t Tissues::largest_stiffness() const {
  return *std::max_element(stiffness_.begin(), stiffness_.end());
}

}  // namespace burrlab
