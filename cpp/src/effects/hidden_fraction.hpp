// The part of a burr that parcels hide from a camera.
#pragma once

#include "effects/sources.hpp"

namespace burrlab {

/// Part 0..1 of the light of the burr's disc in the picture that parcels in front of it absorb. The disc's
/// frame is sampled at 64 x 64 points. Each parcel is a disc with its substances' mean opacity by volume.
/// Bone hides nothing. NaN if the burr is not in the picture. Throws if the camera is wrong or in the burr.
double hidden_fraction(const Parcels& parcels, double quantum, const EffectParameters& parameters,
                       const Camera& camera, const BurrAt& burr);

}  // namespace burrlab
