"""Scenes of a bone, a burr and a path, run by the core on every CPU path and by the slow reference."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab import Burr, BurrContact, Material, Tissue, Tissues, VoxelBone, _core
from reference.tick import ReferenceContact, ReferenceShape, ReferenceTissues

SHAPES = ("parabolic", "linear", "quartic", "constant", "power(1.5)", "power(3)")
TABLES = (  # orders 1, 2 and 2.5 of the zero at x = 1, and none
    "table(1;0:1,0.3:0.2,0.5:0.9,0.8:0.35,1:0)",
    "table(2;0:1,0.5:0.5625,0.75:0.19140625,0.95:0.00950625,1:0)",
    "table(2.5;0:1,0.5:0.48,0.9:0.02,1:0)",
    "table(0;0:1,0.6:1,0.97:0.4,1:0.1)",
)
ALL_SHAPES = (*SHAPES, "power(0.5)", "power(7.3)", *TABLES)
SCHEMES = ("layer", "cell")
FLAGS = ("touching", "ambiguous", "coarse", "faint")
LAWS = tuple((q, m) for q in (1.5, 1.0, 2.0, 1.7) for m in (0.0, 0.5, 1.0))[1:]  # exponents of force and rate
SKEW = (0.13, 0.2, 0.17)  # spacing (x, y, z) [mm]
RATES = (0.0, 0.087, 0.256, 2.0, 1e-4, 40.0, 0.1250001)  # alpha [1/ms], with and without doublings


@dataclass(frozen=True)
class Scene:
    """A bone, a burr and a path."""

    scheme: str
    shape: str
    size: tuple[int, int, int]  # (nz, ny, nx)
    spacing: tuple[float, float, float]  # (x, y, z) [mm]
    origin: tuple[float, float, float]
    ratio: float  # R over the largest spacing
    fill: str
    steps: tuple[tuple[tuple[float, float, float], bool], ...]  # (centre as a share of the volume, burr on)
    snap: float  # centres are rounded to this share of a voxel; 0 for no rounding
    alpha: float
    dt: float
    seed: int
    tick: int
    index: int
    force_exponent: float = 1.5
    rate_exponent: float = 0.0

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
        voxels = np.array([share for share, _ in self.steps]) * (np.array(self.size[::-1]) - 1.0)
        if self.snap:
            voxels = np.round(voxels / self.snap) * self.snap
        return list(np.array(self.origin) + voxels * np.array(self.spacing))


def table_of_tissues(tissues: ReferenceTissues, material: Material) -> Tissues:
    rows = [
        Tissue(f"tissue {i}", label=i, c_e=c_e, alpha=alpha)
        for i, (c_e, alpha) in enumerate(zip(tissues.c_e, tissues.alpha, strict=True))
    ]
    return Tissues(rows, material)


def numbers_of(kind: str, size: tuple[int, ...], count: int) -> NDArray[np.uint8]:
    """Numbers of tissues: one throughout, one per brick, two halves, or one per voxel."""
    random = np.random.default_rng(3)
    if kind == "one":
        return np.full(size, count - 1, np.uint8)
    if kind == "bricks":
        bricks = random.integers(0, count, tuple(-(-n // 8) for n in size)).astype(np.uint8)
        return bricks.repeat(8, 0).repeat(8, 1).repeat(8, 2)[: size[0], : size[1], : size[2]].copy()
    if kind == "halves":
        z, y, x = np.indices(size)
        return np.where(z + y > x, 0, count - 1).astype(np.uint8)
    return random.integers(0, count, size).astype(np.uint8)


def tissues_of(
    kind: str, size: tuple[int, ...], count: int, rates: tuple[float, ...] = RATES, stiffnesses: int = 64
) -> ReferenceTissues:
    c_e = np.random.default_rng(count).uniform(0.2, 5.0, count)
    c_e[-1] = 1000.0
    c_e = c_e[-1 - np.arange(count) % stiffnesses % count]
    alpha = [rates[i % len(rates)] for i in range(count)]
    return ReferenceTissues(numbers_of(kind, size, count), c_e.tolist(), alpha)


def reference_of(
    core: Any, q: NDArray[np.uint8], p: NDArray[np.uint8], tissues: ReferenceTissues | None = None
) -> ReferenceContact:
    """The reference's contact with the values and the tick of `core`; `q` and `p` are not copied."""
    material = core.material
    shape, order = material.shape.name, ReferenceShape(material.shape.name).layer_order
    table = np.asarray(_core.depth_table(order)) if order > 0 else None
    reference = ReferenceContact(
        q, p, core.bone.spacing, core.bone.origin, core.burr.radius, material.c_e, material.alpha, shape,
        core.seed, core.index, core.scheme, table, tissues, material.force_exponent, material.rate_exponent,
    )  # fmt: skip
    reference.tick = core.tick
    return reference


def make_pair(scene: Scene, tissues: ReferenceTissues | None = None) -> tuple[Any, ReferenceContact]:
    """Contacts of the core and of the reference for a scene, each on its own bone."""
    p = scene.pristine()
    bone = VoxelBone(p, spacing=scene.spacing, origin=scene.origin)
    material = Material(
        "any", c_e=2.145, alpha=scene.alpha, shape=scene.shape,
        force_exponent=scene.force_exponent, rate_exponent=scene.rate_exponent,
    )  # fmt: skip
    if tissues is not None:
        bone.set_tissues(table_of_tissues(tissues, material), tissues.number)
    burr = Burr(scene.ratio * max(scene.spacing))
    core = BurrContact(bone, burr, material, scene.seed, scene.index, scheme=scene.scheme)
    core.tick = scene.tick
    return core, reference_of(core, p.copy(), p, tissues)


def on_every_path(
    scene: Scene, tissues: ReferenceTissues | None = None
) -> tuple[list[Any], ReferenceContact]:
    """One contact of the core for each CPU path, and one of the reference."""
    before, cores = _core.cpu_path(), []
    for path in _core.cpu_paths():
        _core.use_cpu_path(path)
        core, reference = make_pair(scene, tissues)
        cores.append(core)
    _core.use_cpu_path(before)
    return cores, reference


def step_both(
    cores: Sequence[Any], reference: ReferenceContact, center: Any, dt: float = 1.0, burr_on: bool = True
) -> Any:
    """What the last core feels in one tick of all; asserts that both are equal to the bit."""
    expected: Any = reference.step(center, dt, burr_on)
    for core in cores:
        got = core.step(center, dt, burr_on=burr_on)
        for name, value in expected.items():
            np.testing.assert_array_equal(getattr(got, name), value, err_msg=name)
        np.testing.assert_array_equal(core.bone.density, reference.q)
        assert core.tick == reference.tick
    return got


def assert_same_sums(bone: Any, numbers: NDArray[np.uint8]) -> None:
    """Asserts that the sums of every tissue are those of the levels."""
    sx, sy, sz = bone.spacing
    dv = sx * sy * sz / 255
    for number in range(len(bone.tissues)):
        here = numbers == number
        left, all_ = (int(levels[here].sum(dtype=np.int64)) for levels in (bone.density, bone.pristine))
        assert (bone.mass_of(number), bone.removed_of(number)) == (left * dv, (all_ - left) * dv)


def check_scene(scene: Scene, tissues: ReferenceTissues | None = None) -> float:
    """Removed volume [mm^3]; all run the scene and are compared after every tick."""
    cores, reference = on_every_path(scene, tissues)
    removed = 0.0
    for center, (_, burr_on) in zip(scene.centers(), scene.steps, strict=True):
        removed += step_both(cores, reference, center, scene.dt, burr_on).removed
        for bone in (core.bone for core in cores):
            np.testing.assert_array_equal(bone.pristine, reference.p)
            if tissues is not None:
                assert_same_sums(bone, tissues.number)
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
