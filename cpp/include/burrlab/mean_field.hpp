// The descent at constant force in the continuum: Eqs. 2-4 without voxels, axisymmetric and deterministic.
// Lengths are in burr radii R, times in 1/alpha. The result depends only on the erosion shape f and on phi =
// F/(c_e R^2). Arguments out of range throw InvalidArgument.
//
//     const auto descent = burrlab::mean_field_descent(burrlab::Shape::parabolic(), /*phi=*/0.05,
//     /*stop=*/0.5); const double velocity = burrlab::window_velocity(descent.time, descent.immersion, 0.2,
//     0.4);  // [alpha R]
#pragma once

#include <vector>

#include "burrlab/shape.hpp"

namespace burrlab {

/// A descent, point by point.
struct MeanFieldDescent {
  std::vector<double> time;       ///< from 0 [1/alpha]
  std::vector<double> immersion;  ///< of the burr's tip, from static contact to the stop [R]
};

/// The descent from static contact, H = phi^(2/3), to H = stop <= 1. The steps follow the thickness of the
/// eroding layer. `resolution`, at most 64, multiplies their number; the error falls with its square.
BURRLAB_API MeanFieldDescent mean_field_descent(const Shape& shape, double phi, double stop,
                                                double resolution = 1.0);

/// Velocity [alpha R] at the immersion H in (0, 1] of a steady layer that is thin against the burr: the limit
/// of small phi, exact for constant f.
BURRLAB_API double thin_layer_velocity(const Shape& shape, double phi, double immersion);

/// Least-squares slope of immersion over time between the immersions `start` and `stop`: uniform weight in
/// time, H(t) linear between its points. Both arrays must rise.
BURRLAB_API double window_velocity(const std::vector<double>& time, const std::vector<double>& immersion,
                                   double start, double stop);

}  // namespace burrlab
