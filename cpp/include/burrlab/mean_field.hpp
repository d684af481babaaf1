// The descent at constant force in the continuum, axisymmetric and deterministic: Eqs. 2-4 without voxels.
// Lengths are in units of the burr radius R, times of 1/alpha; then all depends on f and on
// phi = F/(c_e R^2). Everything here throws std::invalid_argument for arguments out of range.
#pragma once

#include <vector>

#include "burrlab/shape.hpp"

namespace burrlab {

struct MeanFieldDescent {
  std::vector<double> time;       ///< from 0 [1/alpha]
  std::vector<double> immersion;  ///< of the burr's tip, from static contact to the stop [R]
};

/// Descent from static contact at H = phi^(2/3) to H = stop <= 1. The steps follow the thickness of the
/// eroding layer; `resolution` multiplies their number, and the error falls with its square.
MeanFieldDescent mean_field_descent(const Shape& shape, double phi, double stop, double resolution = 1.0);

/// Velocity [alpha R] at immersion H in (0, 1] of a layer thin against H: exact for constant f, and the
/// limit of small phi for any other.
double thin_layer_velocity(const Shape& shape, double phi, double immersion);

/// Least-squares slope of immersion over time between the immersions start and stop; both arrays rise,
/// and H(t) is taken linear between their points.
double window_velocity(const std::vector<double>& time, const std::vector<double>& immersion, double start,
                       double stop);

}  // namespace burrlab
