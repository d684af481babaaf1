"""Comparison of removed bone with a region: exact sums by tissue."""

from dataclasses import replace

import numpy as np
import pytest
from anatomy_scenes import nerve_bone, straight, tool
from command_line import result, said
from session_scenes import ended, refused, session_of

from burrlab import LabelVolume, Tissue, Tissues, VoxelBone, materials, write_volume
from burrlab.anatomy.target import compare_with_target

SHAPE = (9, 10, 12)


def carved() -> tuple[VoxelBone, np.ndarray, np.ndarray]:
    """(a bone of random levels and two tissues, a region, tissue numbers)"""
    random = np.random.default_rng(7)
    bone = VoxelBone(random.integers(0, 256, SHAPE).astype(np.uint8), (0.2, 0.3, 0.5), (1.0, 2.0, 3.0))
    rows = [Tissue(name, label=k, c_e=1.0, alpha=0.1) for k, name in enumerate(("bone", "nerve", "unseen"))]
    numbers = random.integers(0, 2, SHAPE).astype(np.uint8)
    bone.set_tissues(Tissues(rows, materials["bone"]), numbers)
    bone.restore((bone.density * (random.random(SHAPE) < 0.6)).astype(np.uint8))
    return bone, random.random(SHAPE) < 0.4, numbers


def labels_on(bone: VoxelBone, region: np.ndarray) -> LabelVolume:
    place = np.array(bone.spacing), np.array(bone.origin), np.eye(3)
    return LabelVolume(region.astype(np.uint8) * 3, *place, "target.nrrd")


BONE, REGION, NUMBERS = carved()
LABELS = labels_on(BONE, REGION)


def test_sums_by_tissue_are_those_of_the_voxels():
    found = compare_with_target(BONE, REGION)
    unit = 0.2 * 0.3 * 0.5 / 255
    now, lost = BONE.density.astype(int), BONE.pristine.astype(int) - BONE.density
    assert found.tissues == ("bone", "nerve")
    for k in range(2):
        here = k == NUMBERS
        for part, levels, where in (
            (found.overlap, lost, REGION),
            (found.missed, now, REGION),
            (found.excess, lost, ~REGION),
        ):
            assert part[k] == pytest.approx(levels[here & where].sum() * unit, rel=1e-14)
    assert found.removed == pytest.approx(BONE.removed, rel=1e-12)
    due = {
        "volume": REGION.sum() * 0.03, "planned": BONE.pristine[REGION].astype(int).sum() * unit,
        "percent": 100 * found.overlap.sum() / found.planned,
        "dice": 2 * found.overlap.sum() / (found.planned + found.removed),
    }  # fmt: skip
    assert {name: getattr(found, name) for name in due} == pytest.approx(due)


def test_slabs_change_nothing_nor_labels_for_an_array(monkeypatch):
    whole = compare_with_target(BONE, REGION).to_dict()
    assert compare_with_target(BONE, LABELS).to_dict() == whole
    monkeypatch.setattr("burrlab.anatomy.target.AT_A_TIME", 250)
    assert compare_with_target(BONE, REGION).to_dict() == whole


SCAN = replace(LABELS, labels=LABELS.labels.astype(np.int16) - 1000, path="ct.nrrd")
GREYS = replace(LABELS, labels=np.arange(LABELS.labels.size).reshape(LABELS.shape) % 200, path="ct.nrrd")
GREY = r"ct\.nrrd: labels must be zero or positive, got -1000: is this a grey volume\?"


@pytest.mark.parametrize(
    ("target", "onto", "told"),
    [
        (REGION[1:], False, r"target must have the bone's shape \(9, 10, 12\), got \(8, 10, 12\)"),
        (LABELS.resample(LABELS.spacing / 2), False, r"must have the same geometry: .* voxels against .*; onto=True \(--onto\) brings it"),
        (REGION.astype(np.uint8), False, "target must be an array of bool, got uint8"),
        (np.zeros(SHAPE, bool), False, "target must hold bone, got a region with none in it"),
        (REGION, True, "target must be a LabelVolume to be brought onto the bone's voxels"),
        (SCAN, False, GREY), (SCAN, True, GREY),
        (GREYS, False, r"ct\.nrrd: .* at most 64 tissues, and there are 200 .*: is this a grey volume"),
        (replace(LABELS, origin=LABELS.origin + [0.0, 0.1, 0.0]), False,
         "must have the same geometry"),
        (replace(LABELS, spacing=LABELS.spacing * 1.01), False, "must have the same geometry"),
    ],
)  # fmt: skip
def test_bad_targets_are_refused(target, onto, told):
    refused((lambda: compare_with_target(BONE, target, onto=onto), told))


def test_a_target_on_other_voxels_is_brought_onto_the_bone():
    """The region is the same from half as large voxels, from a part of them, and in a turned volume."""
    expected = compare_with_target(BONE, REGION).to_dict()
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    labels = replace(LABELS, origin=turn @ np.array(BONE.origin), direction=turn)
    finer = labels.resample(labels.spacing / 2)
    places = np.argwhere(finer.labels)
    for target in (finer, finer.crop_voxels(tuple(places.min(axis=0)), tuple(places.max(axis=0) + 1))):
        assert compare_with_target(BONE, target, onto=True).to_dict() == expected


def drilled_session(bone, record, tick=0):
    """(bone after a session, its last tick)"""
    device = straight([[0, 0, 1.2], [0, 0, 0.2], [1, 0, 0.2]], [0, 0.2, 0.5])
    return ended(
        session_of(bone, tool(), device, tick=tick, seed=1, wall_clock=False, record=record)
    ).snapshot()


def test_command_line(tmp_path, capsys):
    """With a trace of a bone and a target in a file, as from another program."""
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    bone, record = nerve_bone(), tmp_path / "session.h5"
    region = np.zeros(bone.shape, bool)
    region[-5:] = True
    labels = labels_on(bone, region)
    write_volume(tmp_path / "target.nrrd", labels)
    write_volume(tmp_path / "finer.nrrd", labels.resample(np.array(bone.spacing) / 2))
    write_volume(tmp_path / "wrong.nrrd", replace(labels, origin=np.zeros(3)))
    expected = compare_with_target(drilled_session(bone, record)[0], region).to_dict()
    assert expected["overlap_mm3"] > 0
    for words in (("target.nrrd",), ("finer.nrrd", "--onto")):
        found = result(capsys, "metrics", record, "--target", tmp_path / words[0], *words[1:])["target"]
        assert {key: found[key] for key in expected} == expected
    report = said(capsys, "metrics", record, "--target", tmp_path / "target.nrrd")
    assert ("% of the target's" in report, "before this session" in report) == (True, False)
    assert "--onto goes with --target" in said(capsys, "metrics", record, "--onto", status=2)
    wrong = said(capsys, "metrics", record, "--target", tmp_path / "wrong.nrrd", status=2)
    assert "must have the same geometry" in wrong


def test_a_session_that_went_on_says_what_was_removed_before(tmp_path, capsys):
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    bone, target, tick = nerve_bone(), tmp_path / "target.nrrd", 0
    write_volume(target, labels_on(bone, np.ones(bone.shape, bool)))
    for record in (tmp_path / "session.h5", tmp_path / "next.h5"):
        before = bone.removed
        bone, tick = drilled_session(bone, record, tick)
        found = result(capsys, "metrics", record, "--target", target)["target"]
        assert found["removed_before_mm3"] == before
        assert found["removed_mm3"] == pytest.approx(bone.removed, rel=1e-12)
    report = said(capsys, "metrics", record, "--target", target)
    assert f"{before:.2f} mm^3 of that were removed before this session" in report
