"""A bone, a burr and a path, run by the core and by the slow reference, and compared bit for bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import burrlab
from reference.tick import ReferenceContact, ReferenceShape, ReferenceTissues

SHAPES = ("parabolic", "linear", "quartic", "constant", "power(1.5)", "power(3)")
SCHEMES = ("layer", "cell")
FLAGS = ("touching", "ambiguous", "coarse", "faint")
RELATIVE = 1e-12  # of m0, m1 and the force


@dataclass(frozen=True)
class Scene:
    """A bone, a burr and a path, in units of the voxel where that is more telling."""

    scheme: str
    shape: str
    size: tuple[int, int, int]  # (nz, ny, nx)
    spacing: tuple[float, float, float]  # (x, y, z) [mm]
    origin: tuple[float, float, float]
    ratio: float  # R over the largest spacing
    fill: str
    steps: tuple[tuple[tuple[float, float, float], bool], ...]  # (centre as a share of the volume, burr on)
    snap: float  # centres are rounded to this share of a voxel; 0 for not at all
    alpha: float
    dt: float
    seed: int
    tick: int
    index: int

    def pristine(self) -> NDArray[np.uint8]:
        random = np.random.default_rng([self.seed, self.tick])
        if self.fill == "solid":
            return np.full(self.size, 255, dtype=np.uint8)
        p = random.integers(0, 256, self.size)
        if self.fill == "faint":
            p = random.integers(0, 40, self.size)
        elif self.fill == "sparse":
            p = np.where(random.random(self.size) < 0.6, 0, p)
        elif self.fill == "half":
            p[: self.size[0] // 2] = 0
        return p.astype(np.uint8)

    def centers(self) -> list[NDArray[np.float64]]:
        extent = np.array(self.size[::-1]) - 1.0
        result = []
        for share, _ in self.steps:
            voxel = np.array(share) * extent
            if self.snap:
                voxel = np.round(voxel / self.snap) * self.snap
            result.append(np.array(self.origin) + voxel * np.array(self.spacing))
        return result


def table_of(shape: str) -> NDArray[np.float32] | None:
    order = ReferenceShape(shape).order
    return np.asarray(burrlab._core.depth_table(order)) if order > 0 else None


def table_of_tissues(tissues: ReferenceTissues, material: burrlab.Material) -> burrlab.Tissues:
    rows = [
        burrlab.Tissue(f"tissue {i}", label=i, c_e=c_e, alpha=alpha)
        for i, (c_e, alpha) in enumerate(zip(tissues.c_e, tissues.alpha, strict=True))
    ]
    return burrlab.Tissues(rows, material)


def make_pair(scene: Scene, tissues: ReferenceTissues | None = None) -> tuple[Any, Any, ReferenceContact]:
    """The bone and the contact of the core, and the reference's contact, for a scene."""
    p = scene.pristine()
    radius = scene.ratio * max(scene.spacing)
    bone = burrlab.VoxelBone(p, spacing=scene.spacing, origin=scene.origin)
    material = burrlab.Material("any", c_e=2.145, alpha=scene.alpha, shape=scene.shape)
    if tissues is not None:
        bone.set_tissues(table_of_tissues(tissues, material), tissues.number)
    core = burrlab.BurrContact(
        bone, burrlab.Burr(radius), material, seed=scene.seed, index=scene.index, scheme=scene.scheme
    )
    reference = ReferenceContact(
        p.copy(), p, scene.spacing, scene.origin, radius, 2.145, scene.alpha, scene.shape,
        seed=scene.seed, index=scene.index, scheme=scene.scheme, depth_table=table_of(scene.shape), tissues=tissues,
    )  # fmt: skip
    core.tick = reference.tick = scene.tick
    return bone, core, reference


def assert_same_contact(got: Any, expected: Any, radius: float) -> None:
    """Moments and force to RELATIVE of their size, and the flags."""
    m0 = expected["m0"]
    assert got.m0 == pytest.approx(m0, rel=RELATIVE, abs=0.0)
    np.testing.assert_allclose(got.m1, expected["m1"], rtol=RELATIVE, atol=RELATIVE * m0 * radius)
    assert got.c_e == expected["c_e"]
    assert got.penetration == pytest.approx(expected["penetration"], rel=RELATIVE, abs=0.0)
    np.testing.assert_allclose(got.normal, expected["normal"], rtol=RELATIVE, atol=RELATIVE)
    scale = float(np.linalg.norm(expected["force"]))
    np.testing.assert_allclose(got.force, expected["force"], rtol=RELATIVE, atol=RELATIVE * scale)
    assert got.removed == pytest.approx(expected["removed"], rel=RELATIVE, abs=0.0)
    for flag in FLAGS:
        assert getattr(got, flag) == expected[flag], flag


def assert_same_sums(bone: Any, tissues: ReferenceTissues) -> None:
    """What is left and what was removed of every tissue, counted anew."""
    present, pristine = bone.density, bone.pristine
    sx, sy, sz = bone.spacing
    dv = sx * sy * sz / 255
    for number in range(len(tissues.c_e)):
        here = tissues.number == number
        left, all_ = int(present[here].sum(dtype=np.int64)), int(pristine[here].sum(dtype=np.int64))
        assert bone.mass_of(number) == left * dv
        assert bone.removed_of(number) == (all_ - left) * dv


def check_scene(scene: Scene, tissues: ReferenceTissues | None = None) -> float:
    """Run both, compare after every tick, and return what was removed [mm^3]."""
    bone, core, reference = make_pair(scene, tissues)
    removed = 0.0
    for center, (_, burr_on) in zip(scene.centers(), scene.steps, strict=True):
        expected: Any = reference.step(center, scene.dt, burr_on)
        got = core.step(center, scene.dt, burr_on=burr_on)
        assert_same_contact(got, expected, reference.radius)
        np.testing.assert_array_equal(bone.density, reference.q)
        np.testing.assert_array_equal(bone.pristine, reference.p)
        assert core.tick == reference.tick
        if tissues is not None:
            assert_same_sums(bone, tissues)
        removed += got.removed
    return removed


def scene_of(scheme: str, shape: str, **changes: Any) -> Scene:
    """A burr deep in a random bone for eight ticks."""
    steps = tuple(((0.5, 0.5, 0.9 - 0.05 * i), True) for i in range(8))
    values: dict[str, Any] = {
        "scheme": scheme, "shape": shape, "size": (21, 22, 23), "spacing": (0.2, 0.2, 0.2),
        "origin": (-1.0, 2.0, 30.0), "ratio": 8.0, "fill": "random", "steps": steps, "snap": 0.0,
        "alpha": 0.3, "dt": 1.0, "seed": 2**63 + 11, "tick": 2**32 - 4, "index": 2,
    }  # fmt: skip
    return Scene(**(values | changes))
