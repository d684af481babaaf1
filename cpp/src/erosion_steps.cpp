#include "erosion_steps.hpp"

#include <algorithm>
#include <sstream>

#include "require.hpp"

namespace burrlab {

static std::string described(const Material& material) {
  std::ostringstream text;
  text << "'" << material.name << "' (c_e " << material.c_e << ", alpha " << material.alpha << ", "
       << material.shape.name();
  if (material.force_exponent != Material::paper_force_exponent)
    text << ", force_exponent " << material.force_exponent;
  if (material.rate_exponent != 0.0) text << ", rate_exponent " << material.rate_exponent;
  text << ")";
  return text.str();
}

void check_material(const VoxelBone& bone, const Material& material) {
  if (!bone.tissues() || bone.tissues()->table().material() == material) return;
  throw InvalidArgument("material must be that of the bone's tissues, " +
                        described(bone.tissues()->table().material()) + ", got " + described(material));
}

ErosionSteps::ErosionSteps(double a) {
  if (!(a <= largest)) refuse("alpha dt", "at most 1000", a);
  set(0, a);
}

ErosionSteps::ErosionSteps(const VoxelBone& bone, const Material& material, double dt)
    : ErosionSteps(bone.tissues() ? 0.0 : material.alpha * dt) {
  check_material(bone, material);
  if (!bone.tissues()) return;
  const Tissues& table = bone.tissues()->table();
  count = table.size();
  for (std::size_t i = 0; i < count; ++i) {
    const double step = table[i].alpha * dt;
    if (!(step <= largest)) refuse("alpha dt of '" + table[i].name + "'", "at most 1000", step);
    set(i, step);
  }
}

ErosionSteps ErosionSteps::times(double factor) const noexcept {
  ErosionSteps scaled = *this;
  scaled.most_doublings = 0;
  for (std::size_t i = 0; i < count; ++i) scaled.set(i, std::min(a[i] * factor, largest));
  return scaled;
}

void ErosionSteps::set(std::size_t number, double alpha_dt) noexcept {
  const ErodedFraction step(alpha_dt);
  a[number] = alpha_dt;
  scale[number] = step.scale;
  doublings[number] = step.doublings;
  most_doublings = std::max(most_doublings, step.doublings);
}

}  // namespace burrlab
