#include "effects/parcels.hpp"

#include <algorithm>
#include <cmath>

namespace burrlab {

void Parcels::add(const Vec3& place, const Vec3& speed, const Quanta& quanta) {
  position.push_back(place);
  velocity.push_back(speed);
  mass.push_back(quanta);
  age.push_back(0.0);
  support.push_back(-1);
}

void Parcels::merge(std::size_t a, std::size_t b) {
  const auto of_a = double(total(a)), of_b = double(total(b));
  if (of_b > of_a) position[a] = position[b];
  if (support[a] >= 0 && support[b] >= 0) {
    if (of_b > of_a) support[a] = support[b];
  } else {
    support[a] = -1;
  }
  velocity[a] = (of_a * velocity[a] + of_b * velocity[b]) / (of_a + of_b);
  age[a] = std::max(age[a], age[b]);
  for (int s = 0; s < substances; ++s) {
    mass[a][s] += mass[b][s];
    mass[b][s] = 0;
  }
}

void Parcels::compact() {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < size(); ++i) {
    if (total(i) == 0) continue;
    if (kept != i) {
      position[kept] = position[i];
      velocity[kept] = velocity[i];
      mass[kept] = mass[i];
      age[kept] = age[i];
      support[kept] = support[i];
    }
    ++kept;
  }
  position.resize(kept);
  velocity.resize(kept);
  mass.resize(kept);
  age.resize(kept);
  support.resize(kept);
}

Quanta Parcels::sum() const {
  Quanta sum{};
  for (const Quanta& quanta : mass)
    for (int s = 0; s < substances; ++s) sum[s] += quanta[s];
  return sum;
}

double Parcels::radius(std::size_t i, double quantum, const EffectParameters& parameters) const {
  const double volume = quantum * (parameters.dust_bulking * double(mass[i][dust]) + double(liquid(i)));
  return std::cbrt(0.75 / pi * volume);
}

}  // namespace burrlab
