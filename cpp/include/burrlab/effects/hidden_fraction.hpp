// How much of a burr parcels hide from an eye.
#pragma once

#include "burrlab/effects/instruments.hpp"
#include "burrlab/effects/parcels.hpp"
#include "burrlab/effects/sources.hpp"

namespace burrlab {

/// Part 0..1 of the light of the burr's projected disc, as far as it lies in the picture, that parcels before
/// it take away: the disc is sampled on 64 x 64 points of its frame, each parcel is a disc with the opacity
/// of its mean substance by volume. NaN where the burr is not in the picture. Bone hides nothing here. Throws
/// if the camera is wrong or lies in the burr.
double hidden_fraction(const Parcels& parcels, double quantum, const EffectParameters& parameters,
                       const Camera& camera, const BurrAt& burr);

}  // namespace burrlab
