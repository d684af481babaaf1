// Parcels carry dust, blood and water. Masses are in quanta, one level of one voxel, so that sums are exact.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "burrlab/types.hpp"
#include "effects/effect_parameters.hpp"

namespace burrlab {

enum Substance { dust, blood, water };
constexpr int substances = 3;
constexpr const char* substance_names[substances] = {"dust", "blood", "water"};

using Quanta = std::array<std::int64_t, substances>;  ///< by substance

/// One substance's account [quanta].
struct SubstanceBalance {
  std::int64_t made = 0, present = 0, sucked = 0, drained = 0;
  bool exact() const { return made == present + sucked + drained; }
};

/// A parcel as seen from outside.
struct ParcelView {
  std::array<double, 3> position{}, velocity{};  ///< [mm], [mm/s]
  double radius = 0.0;                           ///< of a sphere of its visible volume [mm]
  std::int64_t dust = 0, blood = 0, water = 0;   ///< [quanta]
  double age = 0.0;                              ///< of its oldest part [s]
};

/// Parcels as a structure of arrays. A parcel with dust and liquid is paste.
class Parcels {
 public:
  std::vector<Vec3> position, velocity;  ///< [mm], [mm/s]
  std::vector<Quanta> mass;
  std::vector<double> age;  ///< [s]
  /// Number of the voxel it rests on, as in LevelField; -1 while it moves.
  std::vector<std::int64_t> support;

  std::size_t size() const { return position.size(); }
  void add(const Vec3& place, const Vec3& speed, const Quanta& quanta);
  /// Moves b's mass and momentum into a, to the place of the heavier one. b keeps no mass.
  void merge(std::size_t a, std::size_t b);
  /// Removes parcels without mass; the others keep their order.
  void compact();
  Quanta sum() const;

  std::int64_t total(std::size_t i) const { return mass[i][dust] + mass[i][blood] + mass[i][water]; }
  std::int64_t liquid(std::size_t i) const { return mass[i][blood] + mass[i][water]; }
  bool dry(std::size_t i) const { return liquid(i) == 0; }
  /// Radius of a sphere of the visible volume [mm]; one quantum is `quantum` mm^3.
  double radius(std::size_t i, double quantum, const EffectParameters& parameters) const;
};

}  // namespace burrlab
