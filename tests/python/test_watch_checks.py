"""Refusals of a watch, and traces without one."""

import numpy as np
import pytest
from anatomy_scenes import BONE, nerve_bone, straight, tool
from session_scenes import ended, refused, session_of, writer

import burrlab
from burrlab.anatomy import Watch, anatomy_report


@pytest.mark.parametrize(
    ("options", "sentence"),
    [({"structures": ["vein"]}, "tissue must be one of bone, nerve, sinus, unused, got 'vein'"),
     ({"structures": ["unused"]}, "structure must have voxels, 'unused' has none"),
     ({"structures": ["nerve", "nerve"]}, "structures must differ, got nerve, nerve"),
     ({"structures": []}, "structures must be at least one, got none"),
     ({"approach": 1.0, "touch": 1.5}, "approach of 'nerve' must be finite and at least touch, got 1"),
     ({"approach": float("nan")}, "approach of 'nerve' must be finite"),
     ({"approach": 15.0}, "approach of 'nerve' with hysteresis and radius must be at most 15 mm"),
     ({"touch": -0.1}, "touch of 'nerve' must be zero or positive"),
     ({"injury": -1.0}, "injury of 'nerve' must be zero or positive"),
     ({"hysteresis": 0.0}, "hysteresis of 'nerve' must be positive"),
     ({"approach": {"bone": 1.0}}, "approach must be of watched structures, got one of 'bone'")],
)  # fmt: skip
def test_a_watch_is_checked(options, sentence) -> None:
    with pytest.raises(ValueError, match=sentence):
        Watch(nerve_bone(), **options)


def plain_bone():
    bone = nerve_bone()
    only = burrlab.Tissues([burrlab.Tissue("bone", label=0, c_e=2.0, alpha=0.1)], BONE)
    bone.set_tissues(only, np.zeros(bone.shape, np.uint8))
    return bone


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Watch(burrlab.VoxelBone.block((2, 2, 2), 0.2)),
         "bone must have tissues, got one of a single material"),
        (lambda: Watch(plain_bone()), "structures must be named: no tissue of the bone is critical"),
        (lambda: session_of(nerve_bone(), tool(), straight([(0, 0, 3), (0, 0, 2)], [0, 1]), watch=Watch(nerve_bone())),
         "bone must be the one that the watch was made of, or a copy of it"),
        (lambda: Watch(nerve_bone(), structures="nerve").distance((0, 0, 0), "sinus"),
         "structure must be one of nerve, got 'sinus'"),
        (lambda: Watch(nerve_bone()).core([7.0]),
         "radius of a burr that is watched must be at most 6 mm, got 7"),
    ],
)  # fmt: skip
def test_a_watch_needs_a_critical_structure_of_the_sessions_bone(make, sentence) -> None:
    with pytest.raises(ValueError, match=sentence):
        make()


def test_limits_and_structures_by_name() -> None:
    watch = Watch(nerve_bone(), approach={"nerve": 1.0}, structures="nerve")
    assert (watch.limits[0].approach, watch.structures) == (1.0, ("nerve",))


def test_a_trace_without_a_watch_takes_no_events(tmp_path) -> None:
    made = writer(tmp_path / "x.h5")
    refused(
        (lambda: made.add_events(np.zeros(0)), "events must be of a trace with a watch"),
        (lambda: made.set_watched(None), "what was watched must be of a trace with a watch"),
    )
    made.stop()


def test_a_session_goes_on_from_a_file_with_its_tissues(tmp_path) -> None:
    """Session, trace and replay begin with a saved, partly removed bone with tissues."""

    def session(bone, first, last, **options):
        device = straight([(0, 0, first), (0, 0, last)], [0, 0.3])
        return session_of(bone, tool(), device, seed=3, duration=0.3, wall_clock=False, **options)

    burrlab.save_bone(tmp_path / "bone.h5", *ended(session(nerve_bone(), 1.5, -0.3)).snapshot())
    bone, tick = burrlab.load_bone(tmp_path / "bone.h5")
    gone = bone.removed_of("nerve")
    assert gone > 0
    second = ended(session(bone, -0.2, -0.8, tick=tick, watch=Watch(bone), record=tmp_path / "on.h5"))
    after, _ = second.snapshot()
    report, trace = second.anatomy(), burrlab.load_trace(tmp_path / "on.h5")
    assert trace.first_tick == tick > 0
    assert report.removed["nerve"] == pytest.approx(after.removed_of("nerve") - gone, abs=1e-9)
    assert anatomy_report(trace).equals(report)
    assert burrlab.replay(trace).equal
