#include "bindings.hpp"
#include "tick.hpp"

void bind_force(py::module_& m) {
  m.def(
      "moments",
      [](const VoxelBone& bone, const Burr& burr, const Vec3& center, const std::string& scheme) {
        const Tick tick(bone, burr.radius, parse_scheme(scheme), Shape::parse("constant"), 0, 0);
        const VoxelBone::Reading reading(bone);
        const Moments found = tick.moments(bone, center);
        return py::make_tuple(found.m0, found.m1);
      },
      "bone"_a, "burr"_a, "center"_a, py::kw_only(), "scheme"_a = "layer",
      R"(First two moments of the bone inside the burr, Eq. 1.

.. math::

   m_0 = \sum_B \frac{\rho}{\rho_0}\, dV, \qquad \mathbf m_1 = \sum_B \frac{\rho}{\rho_0}\, \mathbf r\, dV,

with r from the burr's centre.

Parameters
----------
bone : VoxelBone
burr : Burr
center : (x, y, z)
    [mm]
scheme : {"layer", "cell"}
    How a partly eroded voxel at the boundary is shared; no difference on untouched bone.

Returns
-------
m0 : float
    [mm^3]
m1 : ndarray, shape (3,)
    [mm^4]

Raises
------
ValueError
    If the centre is not finite or the radius below 4 voxels.

Notes
-----
A boundary voxel (spacing s, at distance r) counts by the fraction clamp((R - r)/s + 1/2, 0, 1),
our decision: with a test of centres the force jumps as the burr moves.

Examples
--------
>>> import burrlab
>>> bone, burr = burrlab.VoxelBone.block((8, 8, 3), 0.1), burrlab.Burr(1.5)
>>> m0, m1 = burrlab.moments(bone, burr, (3.95, 3.95, 4.2))
>>> round(m0, 2), m1.round(2).tolist()
(0.28, [0.0, 0.0, -0.37])
)");
  m.def("penetration", &penetration, "m0"_a, "radius"_a,
        R"(Effective penetration depth h, Eq. 2.

.. math::

   u^2 \left(1 - \frac u3\right) = \frac{m_0}{\pi R^3}, \qquad u = h/R,

the smallest positive root; the right side is clamped to 4/3.

Parameters
----------
m0 : float
    [mm^3]
radius : float
    R [mm]

Returns
-------
float
    h [mm], 0 to 2R

Raises
------
ValueError
    If m0 is negative, the radius not positive, or either not finite.

Examples
--------
>>> import math, burrlab
>>> round(burrlab.penetration(math.pi * 0.5**2 * (3 - 0.5 / 3), 3.0), 12)  # a spherical cap of 0.5 mm
0.5
)");
  m.def(
      "elastic_force",
      [](double m0, const Vec3& m1, double radius, double c_e, double force_exponent) {
        return elastic_force({m0, m1}, radius, c_e, force_exponent).force;
      },
      "m0"_a, "m1"_a, py::kw_only(), "radius"_a, "c_e"_a, "force_exponent"_a = Material::paper_force_exponent,
      R"(Elastic force, Eq. 3.

.. math::

   \mathbf F = c_e R^2 (h/R)^q\, \mathbf n

Parameters
----------
m0 : float
    [mm^3]
m1 : (x, y, z)
    [mm^4]
radius : float
    R [mm]
c_e : float
    [N/mm^2]
force_exponent : float
    q, 1 to 8; 3/2 in Eq. 3.

Returns
-------
ndarray, shape (3,)
    [N], out of the bone

Raises
------
ValueError
    If an argument is not finite, m0 negative, radius or c_e not positive, or q not 1 to 8.

Notes
-----
n = -m_1/max(|m_1|, 0.1 m_0 R), our decision: the force fades where its direction is undefined.

Examples
--------
>>> import burrlab
>>> force = burrlab.elastic_force(0.28, (0.0, 0.0, -0.37), radius=1.5, c_e=2.145)
>>> float(force[2].round(2))
0.33
)");
  m.def(
      "erode",
      [](std::shared_ptr<VoxelBone> bone, const Burr& burr, const Vec3& center, const Material& material,
         double dt, std::uint64_t seed, std::uint64_t tick, std::uint32_t index, const std::string& scheme) {
        BurrContact contact(std::move(bone), burr, material, seed, index, parse_scheme(scheme));
        contact.tick = tick;
        return contact.erode(center, dt);
      },
      "bone"_a, "burr"_a, "center"_a, "material"_a, py::kw_only(), "dt"_a, "seed"_a, "tick"_a, "index"_a = 0,
      "scheme"_a = "layer",
      R"(Erodes the bone inside the burr for one tick, Eq. 4.

A mass of M levels that erodes at f loses

.. math::

   \lambda = M \left(1 - e^{-\alpha\, (F/1\,\mathrm N)^m f\, dt}\right)

on average: floor(lambda) levels, and one more with probability frac(lambda). F is the force at `center` before fading.

Parameters
----------
bone : VoxelBone
    Changed in place.
burr : Burr
center : (x, y, z)
    [mm]
material : Material
    In a bone with tissues, that of their table; each tissue erodes at its own alpha.
dt : float
    [ms]
seed, tick, index : int
    The random numbers are a pure function of these and the voxel. `index` is the number of the burr on the
    bone.
scheme : {"layer", "cell"}

Returns
-------
float
    Solid bone removed [mm^3].

Raises
------
ValueError
    If dt is not positive, the centre not finite, the radius below 4 voxels, the material not that of the
    bone's tissues, or the burr too large for their c_e.

Examples
--------
>>> import burrlab
>>> bone, burr = burrlab.VoxelBone.block((8, 8, 3), 0.1), burrlab.Burr(1.5)
>>> round(burrlab.erode(bone, burr, (3.95, 3.95, 4.2), burrlab.materials["bone"], dt=1.0, seed=1, tick=0), 4)
0.0025
)");
}
