"""The core's tick on every CPU path equals the slow reference, bit for bit."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, event, example, given, settings
from hypothesis import strategies as st
from tick_scenes import (
    ALL_SHAPES,
    FLAGS,
    LAWS,
    SCHEMES,
    SHAPES,
    SKEW,
    Scene,
    assert_same_sums,
    check_scene,
    on_every_path,
    reference_of,
    scene_of,
    step_both,
    table_of_tissues,
    tissues_of,
)

import burrlab
from reference.depth import depth_of_full_voxel, depth_of_thin_layer, effective_depth
from reference.tick import WORD, ReferenceContact, bilinear, draw_lanes, philox4x32, portable_pow

PI_COUNTER, PI_KEY = (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344), (0xA4093822, 0x299F31D0)


# --- The reference itself ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rounds", "counter", "key", "expected"),
    [
        (7, (0, 0, 0, 0), (0, 0), (0x5F6FB709, 0x0D893F64, 0x4F121F81, 0x4F730A48)),
        (7, (WORD,) * 4, (WORD,) * 2, (0x5207DDC2, 0x45165E59, 0x4D8EE751, 0x8C52F662)),
        (7, PI_COUNTER, PI_KEY, (0x4DFCCABA, 0x190A87F0, 0xC47362BA, 0xB6B5242A)),
        (10, (0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        (10, (WORD,) * 4, (WORD,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (10, PI_COUNTER, PI_KEY, (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1)),
    ],
)
def test_philox_known_answers(
    rounds: int, counter: tuple[int, ...], key: tuple[int, ...], expected: tuple[int, ...]
) -> None:
    """The vectors published with Random123."""
    assert tuple(int(word) for word in philox4x32(counter, key, rounds)) == expected


def test_lanes_of_a_column() -> None:
    """Voxel y takes the low half of word l >> 1 for even l = y & 7, the high half for odd l."""
    seed, tick, index = 2**40 + 3, 2**35 + 7, 5
    lanes = draw_lanes((2, 11, 3), seed, tick, index, 1)
    z, y, x = 1, 9, 2
    column = (z * 2 + 1) * 3 + x
    words = philox4x32((column, 7, 8, index + 2**31), (3, 2**8))
    assert (lanes[z, y, x], lanes[z, y + 1, x]) == (int(words[0]) >> 16, int(words[1]) & 0xFFFF)


def test_portable_pow_is_a_power() -> None:
    x = np.concatenate([[0.0, 1.0], np.random.default_rng(1).uniform(0.0, 1.0, 1000)])
    for k in (0.5, 1.5, 7.3):
        np.testing.assert_allclose(portable_pow(x, k), x**k, rtol=1e-13)


def test_reference_penetration_of_a_full_sphere() -> None:
    """A sphere full of bone gives h = 2R and no direction."""
    p = np.full((24, 24, 24), 255, dtype=np.uint8)
    contact = ReferenceContact(p.copy(), p, 0.2, (0, 0, 0), 2.0, 2.0, 0.1, "constant", seed=1)
    result: Any = contact.step((2.3, 2.3, 2.3), 1.0, burr_on=False)
    assert result["penetration"] == pytest.approx(4.0, abs=1e-12)
    assert result["m0"] == pytest.approx(4.0 / 3.0 * math.pi * 8.0, rel=5e-3)
    assert result["ambiguous"]
    assert not np.any(result["force"])


# --- The effective depth ----------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [0.5, 1.0, 1.5, 2.0, 3.0, 8.0])
def test_depth_limits(order: float) -> None:
    """At e = 0, G has closed forms for a full voxel and for a thin layer."""
    assert effective_depth(0.0, 1.0, order) == pytest.approx(depth_of_full_voxel(order), rel=1e-9)
    assert effective_depth(0.0, 1e-3, order) == pytest.approx(depth_of_thin_layer(1e-3, order), rel=1e-9)
    assert effective_depth(0.0, 1.0 - 1e-9, order) == pytest.approx(depth_of_full_voxel(order), abs=1e-8)


@pytest.mark.parametrize(
    ("order", "accuracy"), [(0.5, 2e-7), (1.0, 2e-7), (1.5, 2e-7), (2.0, 2e-7), (3.0, 2e-7), (8.0, 1e-5)]
)
def test_depth_table_at_its_nodes(order: float, accuracy: float) -> None:
    """T[i, j] is G(i/8, j/40), rounded to single precision; near e = 0 at high orders to 1e-5."""
    table = burrlab._core.depth_table(order)
    assert (table.dtype, table.shape) == (np.float32, (25, 41))
    exact = np.array([[effective_depth(i / 8, j / 40, order) for j in range(41)] for i in range(25)])
    np.testing.assert_allclose(table, exact, rtol=0.0, atol=accuracy)


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_depth_table_between_its_nodes(order: float) -> None:
    """Bilinear interpolation errs by under 0.005 voxel from tau = 1/40 on, and by under 0.25 below."""
    random = np.random.default_rng(3)
    e = random.uniform(0.0, 3.0, 300).astype(np.float32)
    tau = random.uniform(0.0, 1.0, 300).astype(np.float32)
    exact = np.array([effective_depth(float(a), float(b), order) for a, b in zip(e, tau, strict=True)])
    error = np.abs(bilinear(burrlab._core.depth_table(order), e, tau) - exact)
    assert error[tau >= 1 / 40].max() < 0.005
    assert error.max() < 0.25


# --- Bit for bit ------------------------------------------------------------------------------------------


voxel_size = st.floats(0.05, 0.5)
spacings = st.one_of(
    voxel_size.map(lambda s: (s, s, s)),
    st.tuples(voxel_size, st.floats(1.0, 2.5), st.permutations([0, 1, 2])).map(
        lambda a: tuple(a[0] * (1.0, 1.0, a[1])[i] for i in a[2])
    ),
    st.tuples(st.floats(0.1, 0.3), st.floats(0.1, 0.3), st.floats(0.1, 0.3)),
)
share = st.one_of(st.floats(0.0, 1.0), st.floats(-0.6, 1.6))


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    product = 10.0 ** draw(st.floats(-5.0, 2.5))
    dt = draw(st.sampled_from([0.1, 0.25, 1.0, 2.0, 5.0]))
    return Scene(
        scheme=draw(st.sampled_from(SCHEMES)),
        shape=draw(st.sampled_from(ALL_SHAPES)),
        size=draw(st.tuples(st.integers(1, 22), st.integers(1, 22), st.integers(1, 27))),
        spacing=draw(spacings),
        origin=draw(st.tuples(*[st.floats(-100.0, 100.0)] * 3)),
        ratio=draw(st.floats(4.01, 9.0)),
        fill=draw(st.sampled_from(["solid", "random", "faint", "sparse", "half"])),
        steps=tuple(
            draw(st.lists(st.tuples(st.tuples(share, share, share), st.booleans()), min_size=1, max_size=5))
        ),
        snap=draw(st.sampled_from([0.0, 0.0, 0.5, 1.0])),
        alpha=product / dt,
        dt=dt,
        seed=draw(st.one_of(st.integers(0, 10), st.integers(0, 2**64 - 1))),
        tick=draw(st.one_of(st.integers(0, 10), st.integers(2**32 - 3, 2**64 - 100))),
        index=draw(st.one_of(st.integers(0, 7), st.integers(0, 2**31 - 1))),
        force_exponent=draw(st.sampled_from([1.5, 1.5, 1.0, 2.0, 1.7])),
        rate_exponent=draw(st.sampled_from([0.0, 0.0, 0.5, 1.0, 8.0])),
    )


@pytest.mark.parametrize("fill", ["solid", "random", "faint", "sparse"])
@pytest.mark.parametrize(
    "spacing", [(0.2, 0.2, 0.2), pytest.param((0.2, 0.2, 0.3), marks=pytest.mark.slow), (0.15, 0.25, 0.2)], ids=str
)  # fmt: skip
@pytest.mark.parametrize("shape", ALL_SHAPES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_tick_equals_reference(
    scheme: str, shape: str, spacing: tuple[float, float, float], fill: str
) -> None:
    """Scheme, shape, spacing and fill vary; the tick passes 2^32."""
    assert check_scene(scene_of(scheme, shape, spacing=spacing, fill=fill)) > 0.0


@pytest.mark.parametrize("law", [*LAWS, (1.0, 8.0)], ids=str)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_tick_equals_reference_under_every_law(scheme: str, law: tuple[float, float]) -> None:
    """The force of the same tick sets the rate, in a plain bone and in tissues; with m = 8 a reaches 1000."""
    force_exponent, rate_exponent = law
    for shape, spacing in (("parabolic", (0.2, 0.2, 0.2)), ("power(1.5)", SKEW), ("constant", SKEW)):
        scene = scene_of(
            scheme,
            shape,
            spacing=spacing,
            alpha=0.09,
            force_exponent=force_exponent,
            rate_exponent=rate_exponent,
        )
        assert check_scene(scene) > 0.0
        assert check_scene(scene, tissues_of("random", scene.size, 16, (0.087, 0.0, 2.0))) > 0.0


@pytest.mark.parametrize("product", [1e-5, 1e-3, 0.125, 0.1250001, 0.25, 1.0, 5.0])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_tick_equals_reference_at_every_rate(scheme: str, product: float) -> None:
    """alpha dt runs from 1e-5 to 5, on both sides of the first doubling."""
    assert check_scene(scene_of(scheme, "parabolic", alpha=product / 0.1, dt=0.1, fill="solid")) > 0.0


@pytest.mark.parametrize("scheme", SCHEMES)
def test_tick_equals_reference_until_nothing_is_left(scheme: str) -> None:
    """All levels are equal at every tick from full to empty."""
    steps = (((0.5, 0.5, 0.5), True),) * 60
    check_scene(scene_of(scheme, "constant", steps=steps, alpha=0.2, fill="random"))
    check_scene(scene_of(scheme, "parabolic", steps=steps, alpha=0.5, fill="solid"))


@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(1, 30), marks=pytest.mark.slow)], ids=str)
@pytest.mark.parametrize("spacing", [(0.1, 0.1, 0.1), (0.12, 0.1, 0.11)], ids=str)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_expected_loss_to_the_last_bit(
    scheme: str, shape: str, spacing: tuple[float, float, float], seeds: range
) -> None:
    """Many voxels lose many levels: a change in lambda's last bit shows in about one voxel of 10^5."""
    steps = tuple(((0.5 + 0.01 * i, 0.5, 0.5), True) for i in range(4))
    scene = scene_of(scheme, shape, size=(60, 60, 64), spacing=spacing, ratio=27.0, steps=steps, alpha=0.9)
    for seed in seeds:
        assert check_scene(replace(scene, seed=seed)) > 0.0


@pytest.mark.parametrize("spacing", [(0.25, 0.25, 0.25), (0.25, 0.125, 0.25)], ids=str)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_voxel_exactly_on_the_sphere(scheme: str, shape: str, spacing: tuple[float, float, float]) -> None:
    """A burr of R = 5 voxels on a voxel's centre has distances of exactly 0 and R, coverages of 1/2 and 1."""
    place = {"spacing": spacing, "origin": (0.0, 0.0, 0.0), "ratio": 5.0, "snap": 1.0}
    assert check_scene(scene_of(scheme, shape, **place, fill="solid", alpha=2.0)) > 0.0


@settings(max_examples=250, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@example(scene_of("layer", "parabolic", steps=(((9.0, 0.5, 0.5), True),)))
@example(scene_of("layer", "parabolic", size=(1, 1, 1), steps=(((0.0, 0.0, 0.0), True),)))
@example(scene_of("cell", "linear", size=(3, 5, 8), snap=1.0, spacing=(0.1, 0.2, 0.3)))
@given(scenes())
def test_any_scene_equals_reference(scene: Scene) -> None:
    """Bones, rates, seeds, ticks and indices are random; burrs are in, at and outside the edges."""
    event(f"erodes: {check_scene(scene) > 0.0}")


@pytest.mark.slow
@settings(max_examples=4000, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(scenes())
def test_many_scenes_equal_reference(scene: Scene) -> None:
    check_scene(scene)


@pytest.mark.parametrize("law", [(1.5, 0.0), (1.0, 0.5), (1.7, 1.0), (2.0, 1.0)], ids=str)
@pytest.mark.parametrize("several", [False, True], ids=["one material", "tissues"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_two_burrs_on_one_bone(scheme: str, several: bool, law: tuple[float, float]) -> None:
    """Burrs act in the order of their steps, each with draws of its own, on the same tissues."""
    p = np.random.default_rng(5).integers(0, 256, (20, 21, 25)).astype(np.uint8)
    tissues = tissues_of("random", p.shape, 16) if several else None
    bone, q = burrlab.VoxelBone(p, 0.2), p.copy()
    material = burrlab.Material("any", c_e=1.5, alpha=0.2, force_exponent=law[0], rate_exponent=law[1])
    if tissues is not None:
        bone.set_tissues(table_of_tissues(tissues, material), tissues.number)
    cores = [
        burrlab.BurrContact(bone, burrlab.Burr(radius), material, seed=9, index=index, scheme=scheme)
        for index, radius in enumerate((1.6, 1.1))
    ]
    pairs = [(core, reference_of(core, q, p, tissues)) for core in cores]
    for _ in range(6):
        for core, reference in pairs:
            step_both([core], reference, (2.0 + 0.3 * core.index, 2.1, 2.0))
            if tissues is not None:
                assert_same_sums(bone, tissues.number)


def test_write_sets_both_levels() -> None:
    """After a write, the tick sees the new pristine level."""
    cores, reference = on_every_path(scene_of("layer", "parabolic"))
    center = np.array(reference.origin) + 2.1
    values = np.random.default_rng(6).integers(0, 256, (6, 7, 9)).astype(np.uint8)
    for tick in range(5):
        if tick == 2:
            for core in cores:
                core.bone.write(values, start=(5, 6, 7))
            reference.q[5:11, 6:13, 7:16] = reference.p[5:11, 6:13, 7:16] = values
        step_both(cores, reference, center)
    np.testing.assert_array_equal(cores[0].bone.pristine, reference.p)


ONE, OTHER = (8, 8, 12), (8, 8, 11)


@pytest.mark.parametrize(
    ("levels", "radius", "scheme", "expected"),
    [
        ({}, 2.0, "layer", ""),
        ({ONE: 10, OTHER: 190}, 2.0, "layer", "touching"),
        ({ONE: 10, OTHER: 189}, 2.0, "layer", "touching faint"),
        ({ONE: 10, OTHER: 189}, 2.0, "cell", "touching"),
        ({ONE: 31}, 2.0, "layer", "touching faint"),
        ({ONE: 32}, 2.0, "layer", "touching"),
        ({ONE: 255}, 1.875, "layer", "touching"),
        ({ONE: 255}, 1.874, "layer", "touching coarse"),
        ({(8, 8, 8): 255}, 2.0, "layer", "touching ambiguous"),
    ],
    ids=str,
)
def test_flags_at_their_thresholds(
    levels: dict[tuple[int, int, int], int], radius: float, scheme: str, expected: str
) -> None:
    """faint: more than a twentieth of the mass is below p = 32; coarse: R is below 7.5 voxels of 0.25 mm."""
    p = np.zeros((17, 17, 17), dtype=np.uint8)
    for voxel, level in levels.items():
        p[voxel] = level
    bone, material = burrlab.VoxelBone(p, 0.25), burrlab.Material("any", c_e=1, alpha=1)
    core = burrlab.BurrContact(bone, burrlab.Burr(radius), material, seed=0, scheme=scheme)
    got = step_both([core], reference_of(core, p.copy(), p), (2.0, 2.0, 2.0), burr_on=False)
    assert [flag for flag in FLAGS if getattr(got, flag)] == expected.split()
