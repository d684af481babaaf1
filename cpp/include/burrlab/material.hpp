// A spherical burr, a material (its elastic constant, erosion rate and erosion shape), and how a voxel holds
// it.
//
//     const burrlab::Material& bone = burrlab::paper_material("bone");
//     const burrlab::Material wood("oak", 2.4, 0.05, burrlab::Shape::parse("power(1.5)"), "bench, 2024");
#pragma once

#include <string>
#include <vector>

#include "burrlab/shape.hpp"

namespace burrlab {

/// A spherical burr.
struct BURRLAB_API Burr {
  double radius;  ///< [mm]

  explicit Burr(double radius);  ///< throws InvalidArgument unless the radius is positive and at most 1e6 mm
  bool operator==(const Burr& other) const { return radius == other.radius; }
};

/// The constants of Eqs. 3 and 4.
struct BURRLAB_API Material {
  static constexpr double paper_force_exponent = 1.5;  ///< of Eq. 3
  static constexpr double largest_exponent = 8.0;      ///< of either; 2^q and F^m stay far from overflow

  std::string name;       ///< for reports
  double c_e;             ///< elastic constant [N/mm^2], Eq. 3
  double alpha;           ///< erosion rate [1/ms] at 1 N, Eq. 4; for one f, drill, burr type and speed
  Shape shape;            ///< erosion shape function f of Eq. 4
  std::string source;     ///< source of the numbers
  double force_exponent;  ///< q of |F| = c_e R^2 (h/R)^q; 3/2 in Eq. 3
  double rate_exponent;   ///< m of the rate alpha (|F|/1 N)^m; 0 in Eq. 4

  /// Throws InvalidArgument unless c_e is positive, alpha zero or positive and both finite, the force's
  /// exponent 1 to 8 and the rate's 0 to 8.
  Material(std::string name, double c_e, double alpha, Shape shape, std::string source,
           double force_exponent = paper_force_exponent, double rate_exponent = 0.0);
  bool operator==(const Material& other) const;
};

/// The paper's materials "bone", "pettigrew", "pvc" and "expert" (section 4.2), with their source. The units
/// [N/mm^2] and [1/ms] and the parabolic f are our choices: the paper states neither them nor its voxel size.
BURRLAB_API const std::vector<Material>& paper_materials();
BURRLAB_API const Material& paper_material(const std::string& name);  ///< by name; throws InvalidArgument

/// What is assumed inside a voxel. `cell`: it is uniform and erodes as a whole, as in the paper. `layer`
/// resolves the layer in which a burr cuts, so that results do not depend on voxel size.
enum class Scheme { layer, cell };
BURRLAB_API Scheme parse_scheme(const std::string& name);  ///< by name; throws InvalidArgument

}  // namespace burrlab
