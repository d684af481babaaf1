// Penetration and elastic force from the moments of the bone inside the burr (Eqs. 2 and 3).
//
//     const burrlab::Moments moments{2.0, {0.0, 0.0, -4.0}};  // [mm^3], [mm^4]
//     const burrlab::ElasticForce felt = burrlab::elastic_force(moments, /*radius=*/3.0, /*c_e=*/0.9);
#pragma once

#include "burrlab/material.hpp"
#include "burrlab/types.hpp"

namespace burrlab {

/// m_0 [mm^3] and m_1 [mm^4] of rho/rho_0 inside the burr, about its centre (Eq. 1).
struct Moments {
  double m0 = 0.0;         ///< [mm^3]
  Vec3 m1 = Vec3::Zero();  ///< [mm^4]
};

/// Effective penetration depth h [mm], 0..2R, of m0 [mm^3]: u = h/R is the smallest positive root of u^2 (1 -
/// u/3) = m_0/(pi R^3) (Eq. 2).
BURRLAB_API double penetration(double m0, double radius);

/// |m_1|/(m_0 R) below which the direction of the contact is undefined and the force fades (our decision).
constexpr double fading_asymmetry = 0.1;

/// The force of Eq. 3.
struct ElasticForce {
  Vec3 force = Vec3::Zero();   ///< [N], out of the bone
  Vec3 normal = Vec3::Zero();  ///< -m_1/max(|m_1|, 0.1 m_0 R); shorter than 1 where ambiguous
  double penetration = 0.0;    ///< h [mm]
  double magnitude = 0.0;      ///< |F| before fading [N]
  bool ambiguous = false;      ///< the contact has no direction: the force fades
};

/// F = c_e R^2 (h/R)^q n with the force exponent q, 3/2 in Eq. 3; radius [mm], c_e [N/mm^2]. Both functions
/// throw InvalidArgument for a number out of range.
BURRLAB_API ElasticForce elastic_force(const Moments& moments, double radius, double c_e,
                                       double force_exponent = Material::paper_force_exponent);

}  // namespace burrlab
