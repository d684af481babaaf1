#include "erosion_steps.hpp"

#include <algorithm>
#include <sstream>

#include "require.hpp"

namespace burrlab {

static std::string described(const Material& material) {
  std::ostringstream text;
  text << "'" << material.name << "' (c_e " << material.c_e << ", alpha " << material.alpha << ", "
       << material.shape.name() << ")";
  return text.str();
}

void check_material(const VoxelBone& bone, const Material& material) {
  if (!bone.tissues() || bone.tissues()->table().material() == material) return;
  throw std::invalid_argument("material must be that of the bone's tissues, " +
                              described(bone.tissues()->table().material()) + ", got " + described(material));
}

ErosionSteps::ErosionSteps(double a) { set(0, Tissues::most, a); }

ErosionSteps::ErosionSteps(const VoxelBone& bone, const Material& material, double dt)
    : ErosionSteps(bone.tissues() ? 0.0 : material.alpha * dt) {
  check_material(bone, material);
  if (!bone.tissues()) return;
  const Tissues& table = bone.tissues()->table();
  for (std::size_t i = 0; i < table.size(); ++i) {
    const double a = table[i].alpha * dt;
    if (!(a <= largest)) refuse("alpha dt of '" + table[i].name + "'", "at most 1000", a);
    set(i, i + 1, a);
  }
}

void ErosionSteps::set(std::size_t first, std::size_t end, double a) {
  if (!(a <= largest)) refuse("alpha dt", "at most 1000", a);
  const ErodedFraction step(a);
  std::fill(scale + first, scale + end, step.scale);
  std::fill(doublings + first, doublings + end, step.doublings);
  most_doublings = std::max(most_doublings, step.doublings);
}

}  // namespace burrlab
