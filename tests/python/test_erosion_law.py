"""The core's erosion has the mean loss of its law, and its draws are unrelated; `probe` and `erode` are a `step`."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tick_scenes import SCHEMES, SKEW, make_pair, reference_of, scene_of

import burrlab
from reference.tick import draw_lanes

FALSE_ALARM = 1e-6  # of each statistical test as a whole


def deviation_bound(variance: NDArray[np.float64] | float, tests: int) -> NDArray[np.float64]:
    """Deviation that a sum of independent losses exceeds with a probability below FALSE_ALARM/tests.

    Bernstein's inequality, P(|S - E S| >= t) <= 2 exp(-t^2/(2 (V + t/3))) for terms that vary by at most one.
    It holds for any number of voxels and any lambda, where a normal z-score fails in the tails.
    """
    log_odds = math.log(2.0 * tests / FALSE_ALARM)
    return log_odds / 3.0 + np.sqrt(log_odds**2 / 9.0 + 2.0 * log_odds * np.asarray(variance))


SPACING = 0.05  # [mm]
ONES = np.full((64, 64, 64), 1, dtype=np.uint8)


def block_contact(
    p: NDArray[np.uint8], alpha: float, scheme: str, seed: int, index: int = 0
) -> tuple[Any, Any, NDArray[np.float64]]:
    """Block wholly inside the sphere, contact and centre; with `constant` every voxel erodes alike."""
    bone, burr = burrlab.VoxelBone(p, SPACING), burrlab.Burr(SPACING * (math.sqrt(3) * max(p.shape) / 2 + 2))
    material = burrlab.Material("any", c_e=1.5, alpha=alpha, shape="constant")
    contact = burrlab.BurrContact(bone, burr, material, seed=seed, index=index, scheme=scheme)
    return bone, contact, SPACING * (np.array(p.shape[::-1]) - 1.0) / 2.0


@pytest.mark.parametrize("scheme", SCHEMES)
def test_expected_loss_is_unbiased(scheme: str) -> None:
    """The mean loss of every level M is M (1 - exp(-alpha dt)), over the range of alpha and dt.

    In one tick a voxel loses floor(lambda) or one more, so the sum over n voxels has the variance
    n frac(lambda) (1 - frac(lambda)). Each level at each (alpha, dt) is a test, and so is their sum.
    """
    alphas, dts = (1e-4, 1e-3, 1e-2, 0.1, 1.0), (0.1, 0.5, 1.0, 5.0)
    tests = len(alphas) * len(dts) * 256
    p = (np.arange(64**3) % 256).astype(np.uint8).reshape(64, 64, 64)
    np.random.default_rng(7).shuffle(p.reshape(-1))
    level, count = np.arange(256), np.bincount(p.reshape(-1), minlength=256)
    for i, alpha in enumerate(alphas):
        for j, dt in enumerate(dts):
            bone, contact, center = block_contact(p, alpha, scheme, seed=100 * i + j)
            contact.step(center, dt)
            drop = p.astype(np.int64) - bone.density
            lost = np.bincount(p.reshape(-1), weights=drop.reshape(-1), minlength=256)
            expected = level * -math.expm1(-alpha * dt)
            part = expected - np.floor(expected)
            variance = count * part * (1.0 - part)
            rounding = count * expected * 2.0**-22  # lambda is computed in single precision
            assert np.all(np.abs(lost - count * expected) <= deviation_bound(variance, tests) + rounding), (
                alpha,
                dt,
            )
            total = abs(float((lost - count * expected).sum()))
            assert total <= deviation_bound(variance.sum(), tests) + rounding.sum(), (alpha, dt)
            assert np.all(np.abs(drop - expected[p]) < 1.0 + 1e-4)  # lambda rounded up or down


def test_tiny_losses_are_drawn_from_the_second_number() -> None:
    """Below 2^-16 level a loss needs U = 65535 and V < lo; its rate is still lambda."""
    bone, contact, center = block_contact(ONES, 1e-4, "layer", seed=2**33 + 1)
    q, ticks = ONES.copy(), 200
    reference = reference_of(contact, q, ONES)
    for tick in range(ticks):
        contact.step(center, 0.1)
        if tick < 8:
            reference.step(center, 0.1)
            np.testing.assert_array_equal(bone.density, q)
    assert ONES.sum() > q.sum()
    lost = ONES.size - int(bone.density.sum(dtype=np.int64))
    expected = ONES.size * -math.expm1(ticks * math.expm1(-1e-5))  # a voxel of level 1 can be lost only once
    assert abs(lost - expected) <= deviation_bound(expected, 1)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(
    ("whole", "excess", "lost"), [(0, 0.4, 0), (0, 0.6, 1), (3, 0.25, 0), (3, 0.75, 1)], ids=str
)
def test_loss_at_the_edge_of_its_draw(whole: int, excess: float, lost: int, scheme: str) -> None:
    """Where T + U ends in sixteen ones and V = v, lo = v keeps the level and lo = v + 1 takes it.

    lo is v + excess, rounded; in single precision the excess is uncertain by 0.1 where T = 3.
    """
    seed = 3
    u, v = (draw_lanes(ONES.shape, seed, 0, 0, draw) for draw in (0, 1))
    voxels = np.argwhere((u == 65535 - whole) & (v > 1000))
    assert len(voxels) > 0
    for voxel in map(tuple, voxels):
        expected = whole * 2.0**-16 + (int(v[voxel]) + excess) * 2.0**-32  # [level]
        bone, contact, center = block_contact(ONES, -math.log1p(-expected), scheme, seed)
        reference = reference_of(contact, ONES.copy(), ONES)
        contact.step(center, 1.0)
        assert 1 - bone.density[voxel] == lost
        reference.step(center, 1.0)
        np.testing.assert_array_equal(bone.density, reference.q)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_second_number_decides_only_at_the_edge(scheme: str) -> None:
    """For every V, U = 65534 keeps the level at T = 0, and U = 65535 takes it at T = 1."""
    seed = 3
    u = draw_lanes(ONES.shape, seed, 0, 0, 0)
    for expected, draw, lost in ((0.999 * 2.0**-16, 65534, 0), (1.001 * 2.0**-16, 65535, 1)):
        bone, contact, center = block_contact(ONES, -math.log1p(-expected), scheme, seed)
        contact.step(center, 1.0)
        assert np.any(u == draw)
        assert np.all(1 - bone.density[u == draw] == lost)


def test_draws_of_ticks_burrs_and_seeds_are_unrelated() -> None:
    """Where each voxel loses a level with probability 1/2, two patterns agree on half of the voxels."""
    patterns = []
    for seed, tick, index in [(0, 0, 0), (1, 0, 0), (2**32, 0, 0), (0, 1, 0), (0, 2**32, 0), (0, 0, 1)]:
        bone, contact, center = block_contact(ONES, math.log(2.0), "layer", seed, index)
        contact.tick = tick
        contact.step(center, 1.0)
        patterns.append(bone.density)
    pairs = list(itertools.combinations(patterns, 2))
    for a, b in pairs:
        assert abs(np.count_nonzero(a == b) - ONES.size / 2) <= deviation_bound(ONES.size / 4, len(pairs))


# ---- `probe` and then `erode` equal one `step` ----

FELT = ("force", "normal", "m1", "m0", "penetration", "tick", "touching", "ambiguous", "coarse", "faint")


@pytest.mark.parametrize("spacing", [(0.2, 0.2, 0.2), SKEW], ids=["equal", "skew"])
@pytest.mark.parametrize("fill", ["solid", "random", "faint"])
@pytest.mark.parametrize("shape", ["parabolic", "power(1.5)", "linear", "constant"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_probe_and_erode_are_a_step(
    cpu_path: str, scheme: str, shape: str, fill: str, spacing: tuple[float, float, float]
) -> None:
    """Contacts, removed volume, tick and bone are equal to the last bit."""
    scene = scene_of(
        scheme, shape, fill=fill, spacing=spacing, rate_exponent=0.5 if fill == "random" else 0.0
    )
    whole, halves = (make_pair(scene)[0] for _ in range(2))
    removed = 0.0
    for center in scene.centers():
        expected = whole.step(center, scene.dt)
        got = halves.probe(center)
        for name in FELT:
            np.testing.assert_array_equal(getattr(got, name), getattr(expected, name), err_msg=name)
        assert got.removed == 0.0
        assert (halves.tick, halves.erode(center, scene.dt)) == (expected.tick, expected.removed)
        assert halves.tick == whole.tick == expected.tick + 1
        assert halves.bone.digest() == whole.bone.digest()
        removed += expected.removed
    assert removed > 0.0
    assert halves.bone.removed == whole.bone.removed


@pytest.mark.parametrize("rate_exponent", [0.0, 1.0])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_force_and_erosion_may_act_in_different_places(
    cpu_path: str, scheme: str, rate_exponent: float
) -> None:
    """`erode` does not depend on the probe before it."""
    scene = scene_of(scheme, "quartic", rate_exponent=rate_exponent)
    first, second = scene.centers()[:2]
    found = set()
    for probed in ([], [first], [second]):
        contact, _ = make_pair(scene)
        for place in probed:
            contact.probe(place)
        contact.erode(second, 1.0)
        found.add(contact.bone.digest())
    assert len(found) == 1
