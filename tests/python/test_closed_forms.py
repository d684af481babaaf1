"""Moments (Eq. 1) and force (Eqs. 2, 3) of simple bodies equal closed forms, anywhere in the grid."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

import burrlab

RADIUS = 3.0  # [mm]
BURR = burrlab.Burr(RADIUS)
BONE = burrlab.materials["bone"]
Floats = NDArray[np.float64]

# Ripple: standard deviation over sub-voxel positions, relative to the mean. Measured with the coverage
# fraction: 0.08 % and 0.02 %; with a test of voxel centres: 1.5 % and 0.35 %.
RIPPLE = {0.2: 1.5e-3, 0.1: 4e-4}
BIAS = 5e-3
POSITIONS = 256


def cap(depth: float) -> tuple[float, float]:
    """m_0 [mm^3] and axial m_1 [mm^4] of a spherical cap; the axis points from the centre into it."""
    r, h = RADIUS, depth
    return math.pi * h**2 * (r - h / 3), math.pi / 4 * (2 * r * h - h**2) ** 2


def force_of(m0: float) -> float:
    """Force on the axis by Eqs. 2, 3 [N]."""
    u = burrlab.penetration(m0, RADIUS) / RADIUS
    return BONE.c_e * RADIUS**2 * u**1.5


def half_space_bone(voxel: float, depth: float) -> burrlab.VoxelBone:
    """Solid bone below z = 0, wide enough for a cap of this depth anywhere within a voxel of the axis."""
    width = 2 * math.sqrt(2 * RADIUS * depth) + 6 * voxel
    n = 2 * math.ceil(width / voxel / 2)
    layers = math.ceil(depth / voxel) + 4
    origin = (-(n - 1) / 2 * voxel, -(n - 1) / 2 * voxel, -(layers - 0.5) * voxel)
    return burrlab.VoxelBone.block((n * voxel, n * voxel, layers * voxel), voxel, origin=origin)


def sub_voxel_positions(voxel: float, seed: int) -> Floats:
    """Offsets (x, y, z) of the burr within one voxel [mm]; x, y over the face, z along the axis."""
    return np.random.default_rng(seed).uniform(0, voxel, (POSITIONS, 3))


@pytest.mark.parametrize("radius", [0.5, 3.0])
def test_penetration_inverts_eq_2(radius: float) -> None:
    m = np.append(np.geomspace(1e-12, 1e-3, 100), np.linspace(1e-3, 4 / 3, 4000)[1:])
    u = np.array([burrlab.penetration(share * math.pi * radius**3, radius) / radius for share in m])
    np.testing.assert_allclose(u**2 * (1 - u / 3), m, rtol=1e-12)
    assert np.all(np.diff(u) > 0)
    assert burrlab.penetration(1.1 * 4 / 3 * math.pi * radius**3, radius) == 2 * radius


@pytest.mark.parametrize("scheme", ["layer", "cell"])
@pytest.mark.parametrize("u", [0.05, 0.14, 1 / 3])
def test_moments_of_a_half_space(u: float, scheme: str) -> None:
    depth, voxel = u * RADIUS, 0.1
    bone = half_space_bone(voxel, depth + voxel)
    expected_m0, expected_m1 = cap(depth)
    values = []
    for x, y, _ in sub_voxel_positions(voxel, 1)[:32]:
        m0, m1 = burrlab.moments(bone, BURR, (x, y, RADIUS - depth), scheme=scheme)
        values.append((m0, m1[2]))
        assert np.all(np.abs(m1[:2]) < 5e-3 * expected_m1)
    # for a cap of one and a half voxels the moments are exact to a few per cent only
    tolerance = max(5e-3, 0.25 * (voxel / depth) ** 2)
    np.testing.assert_allclose(np.mean(values, axis=0), (expected_m0, -expected_m1), rtol=tolerance)


@pytest.mark.parametrize(("top", "bottom"), [(-2.0, -2.6), (0.5, -0.5), (1.0, -2.0), (2.5, 1.5)])
def test_moments_of_a_slab(top: float, bottom: float) -> None:
    """The plate is wider than the sphere and ends at grid faces; heights are from the burr's centre."""
    voxel = 0.1
    n = 2 * math.ceil(RADIUS / voxel) + 4
    thickness = top - bottom
    origin = (-(n - 1) / 2 * voxel, -(n - 1) / 2 * voxel, bottom + voxel / 2)
    bone = burrlab.VoxelBone.block((n * voxel, n * voxel, thickness), voxel, origin=origin)
    assert bone.shape[0] == round(thickness / voxel)
    m0, m1 = burrlab.moments(bone, BURR, (0.03, -0.02, 0.0))
    # the cap below the plate's top without the one below its bottom; the axis points down
    expected_m0, expected_m1 = np.subtract(cap(RADIUS + top), cap(RADIUS + bottom))
    assert m0 == pytest.approx(expected_m0, rel=2e-3)
    np.testing.assert_allclose(m1, (0.0, 0.0, -expected_m1), atol=2e-3 * expected_m0 * RADIUS)


@pytest.mark.parametrize("voxel", [0.4, 0.2, 0.1])
def test_moments_of_a_full_sphere(voxel: float) -> None:
    side = 2 * RADIUS + 4 * voxel
    n = math.ceil(side / voxel)
    bone = burrlab.VoxelBone.block((side,) * 3, voxel, origin=(-(n - 1) / 2 * voxel,) * 3)
    volume = 4 / 3 * math.pi * RADIUS**3
    for offset in sub_voxel_positions(voxel, 2)[:16]:
        m0, m1 = burrlab.moments(bone, BURR, offset)
        # the linear coverage of a boundary voxel adds a shell of relative volume s^2/(4 R^2)
        assert m0 == pytest.approx(volume * (1 + voxel**2 / (4 * RADIUS**2)), rel=2e-3)
        assert np.linalg.norm(m1) < 2e-3 * volume * RADIUS


def test_moments_scale_with_the_level() -> None:
    """A level of 51 has a fifth of the mass of solid bone."""
    solid = burrlab.VoxelBone.block((8, 8, 3), 0.2, origin=(-4, -4, -3))
    thin = burrlab.VoxelBone.block((8, 8, 3), 0.2, origin=(-4, -4, -3), level=51)
    center = (0.05, -0.03, 2.6)
    m0, m1 = burrlab.moments(solid, BURR, center)
    thin_m0, thin_m1 = burrlab.moments(thin, BURR, center)
    assert thin_m0 == pytest.approx(m0 / 5, rel=1e-4)
    np.testing.assert_allclose(thin_m1, m1 / 5, rtol=1e-3, atol=1e-4 * m0)


def axial_force(bone: burrlab.VoxelBone, center: Floats) -> float:
    m0, m1 = burrlab.moments(bone, BURR, center)
    return burrlab.elastic_force(m0, m1, radius=RADIUS, c_e=BONE.c_e)[2]


def centre_test_force(bone: burrlab.VoxelBone, center: Floats) -> float:
    """Force if a voxel counts whole where its centre is inside the sphere, else not."""
    nz, ny, nx = bone.shape
    x, y, z = (
        bone.origin[i] + bone.spacing[i] * np.arange(n) - center[i] for i, n in enumerate((nx, ny, nz))
    )
    inside = z[:, None, None] ** 2 + y[:, None] ** 2 + x**2 <= RADIUS**2
    return force_of(float(inside.sum()) * math.prod(bone.spacing))


@pytest.mark.parametrize("voxel", RIPPLE)
@pytest.mark.parametrize("along", ["across", "into"])
def test_force_ripple_over_sub_voxel_positions(voxel: float, along: str) -> None:
    """The force on a half-space is the closed form anywhere in the grid, about u = 0.14.

    ``across`` moves the burr over a voxel's face at one depth. ``into`` also moves it along the axis, by up
    to a voxel; each force is divided by the closed form at its depth.
    """
    bone = half_space_bone(voxel, 0.14 * RADIUS + 2 * voxel)
    ratios, naive = [], []
    for x, y, z in sub_voxel_positions(voxel, 3):
        depth = 0.14 * RADIUS + (z - voxel / 2 if along == "into" else 0.0)
        expected = force_of(cap(depth)[0])
        center = np.array([x, y, RADIUS - depth])
        ratios.append(axial_force(bone, center) / expected)
        naive.append(centre_test_force(bone, center) / expected)
    assert abs(np.mean(ratios) - 1) < BIAS
    assert np.std(ratios) <= RIPPLE[voxel]
    assert np.std(naive) > 3 * RIPPLE[voxel], "the bound is too wide: a test of voxel centres keeps it too"


@pytest.mark.parametrize("spacing", [(0.1, 0.1, 0.2), (0.2, 0.1, 0.15)])
def test_force_on_voxels_that_are_not_cubes(spacing: tuple[float, float, float]) -> None:
    depth = 0.14 * RADIUS
    specimen = burrlab.half_space(BURR, spacing, depth=depth)
    rng = np.random.default_rng(4)
    shifts = np.column_stack([rng.uniform(-0.5, 0.5, (64, 2)) * spacing[:2], np.zeros(64)])
    forces = [axial_force(specimen.bone, specimen.center(depth, BURR) + shift) for shift in shifts]
    expected = force_of(cap(depth)[0])
    assert abs(np.mean(forces) / expected - 1) < 1e-2
    assert np.std(forces) / expected < 1.5e-3
