"""Mass, sums of bricks and digest of a bone follow its levels, whatever changes them."""

import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test
from numpy.typing import NDArray
from tick_scenes import SCHEMES, reference_of, step_both

from burrlab import Burr, BurrContact, Material, VoxelBone, _core

Levels = NDArray[np.uint8]
SPACING = (0.25, 0.5, 0.125)  # (x, y, z) [mm]; powers of two, so that sums of products are exact
ORIGIN = (-1.0, 8.0, 0.5)
VOLUME = 0.25 * 0.5 * 0.125  # of a voxel [mm^3]


def rebuilt(pristine: Levels, density: Levels) -> VoxelBone:
    """The bone unpickled from these levels."""
    bone: VoxelBone = VoxelBone.__new__(VoxelBone)
    bone.__setstate__((pristine, density, SPACING, ORIGIN))  # type: ignore[attr-defined]
    return bone


def assert_sums_match(bone: VoxelBone, density: Levels) -> None:
    """Asserts that mass, and moments of a sphere around the bone, are exactly those of its levels."""
    q, unit = density.astype(np.int64), VOLUME / 65280
    total = int(q.sum())
    assert bone.mass == total * (VOLUME / 255)
    base, part = (3, -2, 5), 0.25  # the centre, in voxels
    center = [o + s * (b + part) for o, s, b in zip(ORIGIN, SPACING, base, strict=True)]
    reach = float(np.linalg.norm((np.array(bone.shape[::-1]) + 8.0) * SPACING) + 1.0)
    index = np.indices(q.shape)[::-1]
    first = [int((q * (index[axis] - base[axis])).sum()) for axis in range(3)]
    for scheme in SCHEMES:
        m0, m1 = _core.moments(bone, Burr(reach), center, scheme=scheme)
        assert m0 == 256 * total * unit
        expected = [
            256 * (along - part * total) * (s * unit) for along, s in zip(first, SPACING, strict=True)
        ]
        assert m1.tolist() == expected


class Bones(RuleBasedStateMachine):
    """Random sequences of changes of a bone, compared with plain arrays and the slow reference."""

    @initialize(
        size=st.tuples(st.integers(1, 20), st.integers(1, 20), st.integers(1, 27)),
        level=st.sampled_from([0, 7, 255]),
    )
    def begin(self, size: tuple[int, int, int], level: int) -> None:
        self.p = np.full(size, level, dtype=np.uint8)
        self.q = self.p.copy()
        self.bone = VoxelBone(self.p, SPACING, ORIGIN)
        self.tick = 0
        self.kept: list[tuple[Any, Levels, Levels]] = []  # copies, and their levels

    @rule(
        data=st.data(),
        fill=st.sampled_from(["level", "random", "faint"]),
        seed=st.integers(0, 999),
    )
    def write(self, data: st.DataObject, fill: str, seed: int) -> None:
        start = [data.draw(st.integers(0, n - 1)) for n in self.q.shape]
        size = [data.draw(st.integers(1, n - a)) for n, a in zip(self.q.shape, start, strict=True)]
        random = np.random.default_rng(seed)
        if fill == "level":
            values = np.full(size, random.choice([0, 0, 1, 100, 255]), dtype=np.uint8)
        else:
            values = random.integers(0, 40 if fill == "faint" else 256, size).astype(np.uint8)
        self.bone.write(values, start=start)
        box = tuple(slice(a, a + n) for a, n in zip(start, size, strict=True))
        self.q[box] = self.p[box] = values

    @rule(
        share=st.tuples(*[st.floats(-0.1, 1.1)] * 3),
        scheme=st.sampled_from(SCHEMES),
        shape=st.sampled_from(["parabolic", "linear", "constant", "power(1.5)"]),
        alpha=st.sampled_from([0.01, 0.5, 5.0, 900.0]),
        path=st.sampled_from(_core.cpu_paths()),
        radius=st.sampled_from([2.0, 2.7, 4.0]),
    )
    def step(
        self, share: tuple[float, ...], scheme: str, shape: str, alpha: float, path: str, radius: float
    ) -> None:
        center = ORIGIN + np.array(share) * (np.array(self.bone.shape[::-1]) - 1.0) * SPACING
        _core.use_cpu_path(path)
        material = Material("any", c_e=1.5, alpha=alpha, shape=shape)
        contact = BurrContact(self.bone, Burr(radius), material, seed=5, scheme=scheme)
        contact.tick = self.tick
        step_both([contact], reference_of(contact, self.q, self.p), center)
        self.tick += 1

    @rule()
    def reset(self) -> None:
        self.bone.reset()
        self.q[...] = self.p

    @rule(how=st.sampled_from(["copy", "pickle"]), go_on_with_the_copy=st.booleans())
    def duplicate(self, how: str, go_on_with_the_copy: bool) -> None:
        copy = self.bone.copy() if how == "copy" else pickle.loads(pickle.dumps(self.bone))
        kept, self.bone = (self.bone, copy) if go_on_with_the_copy else (copy, self.bone)
        self.kept.append((kept, self.q.copy(), self.p.copy()))

    @rule(seed=st.integers(0, 999))
    def restore(self, seed: int) -> None:
        """Takes any levels up to the pristine ones, as of a snapshot."""
        self.q = (self.p * np.random.default_rng(seed).choice([0.0, 0.5, 1.0], self.q.shape)).astype(np.uint8)
        self.bone = rebuilt(self.p, self.q)

    @rule()
    def go_back(self) -> None:
        if self.kept:
            self.bone, self.q, self.p = self.kept.pop()

    @invariant()
    def levels_match(self) -> None:
        np.testing.assert_array_equal(self.bone.density, self.q)
        np.testing.assert_array_equal(self.bone.pristine, self.p)
        assert self.bone.removed == int((self.p - self.q).sum(dtype=np.int64)) * (VOLUME / 255)
        assert_sums_match(self.bone, self.q)

    @invariant()
    def digest_is_of_the_levels_alone(self) -> None:
        digest = self.bone.digest()
        assert rebuilt(self.p, self.q).digest() == digest
        assert pickle.loads(pickle.dumps(self.bone)).digest() == digest
        assert (VoxelBone(self.p, SPACING, ORIGIN).digest() == digest) == np.array_equal(self.p, self.q)

    def teardown(self) -> None:
        for bone, q, p in getattr(self, "kept", []):
            np.testing.assert_array_equal(bone.density, q)
            np.testing.assert_array_equal(bone.pristine, p)
            assert rebuilt(p, q).digest() == bone.digest()


@pytest.mark.usefixtures("keep_cpu_path")
def test_random_sequences() -> None:
    """Mass, moments, digest and copies are right after every step of 120 sequences of up to 15."""
    run_state_machine_as_test(
        Bones,
        settings=settings(
            max_examples=120,
            stateful_step_count=15,
            deadline=None,
            derandomize=True,
            suppress_health_check=list(HealthCheck),
        ),
    )


@pytest.mark.parametrize("shape", [(5, 9, 300), (300, 9, 5), (9, 300, 5)])
def test_erosion_of_everything(cpu_path: str, shape: tuple[int, int, int]) -> None:
    """A burr that goes along a bar removes all bone behind it and none ahead, in any grid direction."""
    bone = VoxelBone(np.full(shape, 255, dtype=np.uint8), 0.25)
    contact = BurrContact(
        bone, Burr(3.0), Material("any", c_e=1.0, alpha=100.0, shape="constant"), seed=1, scheme="cell"
    )
    axis = 2 - int(np.argmax(shape))
    middle = (np.array(shape[::-1]) - 1) * 0.125
    for along in np.arange(0.0, 75.1, 0.5):
        middle[axis] = along
        contact.step(middle, 1.0)
        behind = int((along + 1.0) / 0.25)
        density = np.moveaxis(bone.density, 2 - axis, 0)
        assert not density[:behind].any()
        assert np.all(density[behind + 20 :] == 255)
        assert bone.mass == int(density.sum(dtype=np.int64)) * (0.25**3 / 255)
    assert bone.mass == 0.0
    assert not contact.probe(middle).touching
    bone.reset()
    assert bone.removed == 0.0
    assert contact.probe(middle).touching
