"""The scripted mastoidectomy: it carves the planned cavity and little else."""

import itertools

import numpy as np
import pytest
from scipy import ndimage
from session_scenes import ended, session_of

import burrlab
from burrlab.anatomy import Phantom, compare_with_target, mastoidectomy_path, temporal_bone

BURR = burrlab.Burr(3.0)


@pytest.fixture(scope="module", params=["right", "left"])
def phantom(request) -> Phantom:
    return temporal_bone(0.5, seed=3, side=request.param)


def sampled(path, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres, and whether the burr turns, every dt [ms]."""
    at = np.arange(0.0, path.duration, dt / 1000.0)
    center = np.column_stack([np.interp(at, path.time, places) for places in path.center.T])
    return center, path.on[np.searchsorted(path.time, at, side="right") - 1]


def drill(phantom: Phantom, path) -> burrlab.VoxelBone:
    contact = burrlab.BurrContact(phantom.bone, BURR, burrlab.materials["bone"], seed=1)
    center, on = sampled(path, 2.0)
    turns = np.flatnonzero(np.diff(on.astype(int))) + 1
    for a, b in itertools.pairwise([0, *turns, len(on)]):
        contact.run(center[a:b], 2.0, bool(on[a]))
    return contact.bone


def test_it_carves_the_plan(phantom):
    path = mastoidectomy_path(phantom, BURR, layer=1.0, step=1.5, speed=30)
    cut = compare_with_target(drill(phantom, path), phantom.target)
    assert cut.percent > 75
    assert cut.excess.sum() < 0.03 * cut.planned
    injured = dict(zip(cut.tissues, cut.overlap + cut.excess, strict=True))
    for name in ("facial nerve", "sigmoid sinus", "dura", "labyrinth"):
        assert injured.get(name, 0.0) == 0


def test_the_turning_burr_stays_in_the_plan_or_in_the_open(phantom):
    """The distance from each centre to bone outside the plan comes from an independent transform."""
    forbidden = (phantom.bone.pristine > 0) & ~phantom.target
    pad = 16
    away = ndimage.distance_transform_edt(~np.pad(forbidden, pad), sampling=phantom.bone.spacing[::-1])
    center, on = sampled(mastoidectomy_path(phantom, BURR, layer=1.0, step=1.5), 20.0)
    at = np.rint((center[on] - phantom.bone.origin) / phantom.bone.spacing).astype(int)[:, ::-1] + pad
    assert away[tuple(at.T)].min() > BURR.radius - 0.9  # the diagonal of a voxel
    assert on.mean() > 0.5


def test_a_session_takes_it(phantom):
    path = mastoidectomy_path(phantom, BURR, layer=1.5, step=2.0, speed=60, depth=4.0)
    tool, options = (BURR, burrlab.materials["bone"]), {"seed": 1, "wall_clock": False, "coupling": 5.0}
    session = ended(session_of(phantom.bone, tool, path.device(), **options))
    assert compare_with_target(session.snapshot()[0], phantom.target).overlap.sum() > 100


def test_depth_and_layers(phantom):
    shallow = mastoidectomy_path(phantom, BURR, layer=1.0, depth=5.0)
    whole = mastoidectomy_path(phantom, BURR, layer=1.0)
    assert shallow.layers < whole.layers
    deepest = np.abs(shallow.center[shallow.on, 0] + np.sign(phantom.axis[0]) * BURR.radius)
    assert deepest.max() <= 5.0 + 0.5
    assert np.all(np.diff(whole.time) > 0)
    assert (whole.on[-1], whole.duration) == (False, whole.time[-1])


PART = temporal_bone(0.5, seed=3, size=(6, 6, 6), corner=(20, -6, -6))


@pytest.mark.parametrize(
    ("place", "burr", "options", "told"),
    [
        *((None, BURR, {name: -1.0},
            f"{name} must be positive, got -1") for name in ("layer", "step", "speed", "depth")),
        (None, burrlab.Burr(40.0), {}, "burr of 40 mm fits nowhere into the planned cavity"),
        (PART, BURR, {}, "phantom must hold some of the planned cavity"),
    ],
)  # fmt: skip
def test_what_is_refused(phantom, place, burr, options, told):
    with pytest.raises(ValueError, match=told):
        mastoidectomy_path(place or phantom, burr, **options)
