"""Volumes on the command line: resampling, crops, refusals, and a real CT."""

import pytest
from command_line import result, said

import burrlab
from burrlab.session.network import make_bone

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
from volume_scenes import ASKEW, slab


def test_a_clinical_volume_resampled_from_the_command_line(tmp_path, capsys):
    volume, way = slab(tmp_path / "ct.nrrd")
    ask = ["descend", "--force", "0.3", "--radius", "1", "--ideal", "--seed", "1", *way]
    ask += ["--volume", tmp_path / "ct.nrrd", "--map", "-1000:1000"]
    small = "radius of the burr must be at least 4 voxels of 0.4 mm, got 1 mm; --voxel 0.13 (voxel=0.13) makes finer ones"
    assert small in said(capsys, *ask, status=2)
    low, high = volume.patient_point((5, 5, 0)), volume.patient_point((15, 15, 12))
    crop = ":".join(",".join(map(repr, (volume.origin + corner).tolist())) for corner in (low, high))
    sunk = result(capsys, *ask, "--voxel", "0.13", "--crop", crop)
    made = sunk["provenance"]["volume"]
    assert (sunk["status"], made["voxel_mm"], made["recipe"]["map"], make_bone(made["recipe"]).spacing) == (
        "ok", [0.13] * 3, [-1000, 1000], (0.13,) * 3,
    )  # fmt: skip
    fine, _ = slab(tmp_path / "fine.nrrd", 0.1)
    direct = burrlab.descend(
        burrlab.Burr(1.0), burrlab.materials["bone"], 0.3, specimen=fine.specimen(burrlab.OccupancyMap.two_point(-1000, 1000), entry=fine.origin + ASKEW @ (10, 10, 11.5),
        axis=-ASKEW[:, 2]), seed=1, ideal=True,
    )  # fmt: skip
    # The interpolated rim is 0.4 mm wide and the burr meets less bone at first: velocities are only similar.
    assert sunk["penetration_velocity_mm_s"] == pytest.approx(direct.penetration_velocity, rel=0.3)


def test_an_assumed_orientation_is_printed(tmp_path, capsys):
    """The file has no orientation in the patient."""
    head = b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 20 20 12\nspacings: 0.5 0.5 0.5\nencoding: raw\n\n"
    (tmp_path / "ct.nrrd").write_bytes(head + bytes([200]) * 4800)
    ask = ["--volume", tmp_path / "ct.nrrd", "--map", "0:100", "--seed", "1", "--radius", "2.5"]
    ask += ["--entry", "4.75,4.75,7", "--axis", "0,0,-1"]
    for command in (
        ["descend", "--force", "1", "--ideal"],
        ["session", "--device", "hand", "--duration", "0.05", "--no-realtime"],
    ):
        told = said(capsys, *command, *ask)
        assert "burrlab: the NRRD header" in told
        assert "L, P, S" in told


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--spacing", "1"], "--spacing goes with --volume"),
        (["--crop", "1,1,1:2,2,2"], "--crop goes with --volume"),
        (["--series", "1"], "--series goes with --volume"),
        (["--crop", "1,1,1"], "--crop: must be X,Y,Z:X,Y,Z, got '1,1,1'"),
        (["--crop", "1,1,nan:1,1,1"], "--crop: must be X,Y,Z:X,Y,Z of finite numbers"),
        (["--spacing", "1,1"], "--spacing: must be positive X,Y,Z, got '1,1'"),
        (["--spacing", "0"], "--spacing: must be positive X,Y,Z, got '0'"),
        (["--map", "0:0,1"], "--map: must be LO:HI or GREY:OCCUPANCY,GREY:OCCUPANCY,..., got '0:0,1'"),
    ],
)
@pytest.mark.parametrize("command", [["descend", "--force", "1"], ["session", "--device", "hand"]])
def test_wrong_options(capsys, command, words, message):
    assert message in said(capsys, *command, *words, status=2)
