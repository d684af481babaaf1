"""Descents into volumes: on voxels that are no cubes, in turned volumes, from the command line, and in a real CT."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import burrlab
from burrlab.cli import main
from burrlab.fitting.voxel_descent import VoxelSettings
from burrlab.session.network import make_bone, volume_recipe
from burrlab.volume import OccupancyMap, Volume, VolumeRecipe

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")

BURR, BONE = burrlab.Burr(3.0), burrlab.materials["bone"]
HAND = Path("/work/shared/data/volumes/hand_ct.nrrd")
needs_hand = pytest.mark.skipif(not HAND.is_file(), reason="the CT of a hand is not on this machine")
PERMUTED = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # left-handed
TURNED = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]


def half_space_volume(voxel, axis, direction):
    """A volume whose bone is `half_space`, and entry and axis in its own coordinates."""
    made = burrlab.half_space(BURR, voxel, axis=axis, offset=(0.03, 0.04, 0.02))
    bone = made.bone
    volume = Volume(bone.density, bone.spacing, direction @ bone.origin, direction, "half-space")
    return volume, {"entry": direction @ (made.surface - 5 * made.axis), "axis": direction @ made.axis}


def descent(volume, way, force=1.0):
    specimen = volume.specimen(0, 255, **way)
    return burrlab.descend(BURR, BONE, force, specimen=specimen, seed=1, ideal=True)


@pytest.mark.parametrize("axis", [(0, 0, -1), (-1, 0, 0), (0, 1, 0), (1, 1, -1), (1, 2, 3)])
@pytest.mark.parametrize("force", [1.0, 2.0])
def test_anisotropic_equals_isotropic(tmp_path, axis, force):
    found = []
    for name, voxel in (("a.nrrd", 0.1), ("b.nii.gz", (0.1, 0.1, 0.2))):
        volume, way = half_space_volume(voxel, axis, np.eye(3))
        burrlab.write_volume(tmp_path / name, volume)
        found.append(descent(burrlab.read_volume(tmp_path / name), way, force).penetration_velocity)
    assert found[1] == pytest.approx(found[0], rel=0.05)  # measured: at most 1.7 %


@pytest.mark.parametrize("direction", [PERMUTED, np.diag([1.0, 1.0, -1.0])], ids=["permuted", "mirrored"])
def test_the_same_voxels_otherwise_placed_give_the_same_bits(tmp_path, direction):
    straight = descent(*half_space_volume(0.1, (0, 0, -1), np.eye(3)))
    volume, way = half_space_volume(0.1, (0, 0, -1), direction)
    burrlab.write_volume(tmp_path / "v.nrrd", volume)
    run = descent(burrlab.read_volume(tmp_path / "v.nrrd"), way)
    np.testing.assert_array_equal(run.immersion, straight.immersion)
    np.testing.assert_array_equal(run.force, straight.force)


@pytest.mark.parametrize("direction", [TURNED, TURNED * (1, 1, -1)], ids=["turned", "turned and left-handed"])
@pytest.mark.parametrize("name", ["v.nrrd", "v.mha"])
def test_a_turned_volume_gives_the_same_within_rounding(tmp_path, direction, name):
    straight = descent(*half_space_volume(0.1, (0, 0, -1), np.eye(3)))
    volume, way = half_space_volume(0.1, (0, 0, -1), direction)
    burrlab.write_volume(tmp_path / name, volume)
    run = descent(burrlab.read_volume(tmp_path / name), way)
    # A last digit of the entry may turn a draw, one level of one voxel: measured 2e-6 mm.
    np.testing.assert_allclose(run.immersion, straight.immersion, rtol=0, atol=2e-5)
    assert run.penetration_velocity == pytest.approx(straight.penetration_velocity, rel=1e-4)


def test_the_surface_of_bone_that_ends_with_the_volume_is_its_face():
    volume, way = half_space_volume((0.1, 0.1, 0.4), (0, 0, -1), np.eye(3))
    assert volume.specimen(0, 255, **way).surface[2] == pytest.approx(0.0, abs=0.01 * 0.4)


def slab(path, spacing=0.4):
    """20 x 20 x 12 mm, its upper third empty; turned."""
    n = [round(side / spacing) for side in (20, 20, 12)]
    values = np.full(n[::-1], 1000, np.int16)
    values[2 * n[2] // 3 :] = -1000
    volume = Volume(values, (spacing,) * 3, (100, 50, -20), TURNED, "slab")
    burrlab.write_volume(path, volume)
    entry = volume.origin + TURNED @ (10, 10, 11.5)
    return volume, [
        f"--entry={','.join(map(repr, entry.tolist()))}",
        f"--axis={','.join(map(repr, (-TURNED[:, 2]).tolist()))}",
    ]


def test_a_clinical_volume_resampled_from_the_command_line(tmp_path, capsys):
    path = tmp_path / "ct.nrrd"
    volume, way = slab(path)
    ask = [
        "descend",
        "--volume",
        str(path),
        "--map",
        "-1000:1000",
        "--force",
        "0.3",
        "--radius",
        "1",
        "--ideal",
        "--seed",
        "1",
    ]
    assert main([*ask, *way]) == 2
    said = capsys.readouterr().err
    assert (
        "radius of the burr must be at least 4 voxels of 0.4 mm, got 1 mm; --voxel 0.13 (voxel=0.13) makes finer ones"
        in said
    )
    low, high = volume.patient_point((5, 5, 0)), volume.patient_point((15, 15, 12))
    crop = ":".join(",".join(map(repr, (volume.origin + corner).tolist())) for corner in (low, high))
    assert main([*ask, *way, "--voxel", "0.13", "--crop", crop, "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["status"] == "ok"
    made = result["provenance"]["volume"]
    assert made["voxel_mm"] == [0.13] * 3
    assert made["recipe"]["map"] == [-1000, 1000]
    assert make_bone(made["recipe"]).spacing == (0.13,) * 3
    fine, way = slab(tmp_path / "fine.nrrd", 0.1)
    direct = burrlab.descend(
        burrlab.Burr(1.0), BONE, 0.3, specimen=fine.specimen(-1000, 1000, entry=fine.origin + TURNED @ (10, 10, 11.5),
        axis=-TURNED[:, 2]), seed=1, ideal=True,
    )  # fmt: skip
    # The interpolated rim is 0.4 mm wide, so the burr meets less bone at first: not equal, but no other regime.
    assert result["penetration_velocity_mm_s"] == pytest.approx(direct.penetration_velocity, rel=0.3)


def test_results_keep_how_the_bone_was_made(tmp_path):
    """Map, voxels and crop, from descent to curve and fit, through their files."""
    volume, _ = slab(tmp_path / "ct.nrrd")
    crop = (volume.origin.tolist(), (volume.origin + TURNED @ (19, 19, 11)).tolist())
    recipe = VolumeRecipe(
        tmp_path / "ct.nrrd", OccupancyMap.table([-1000, 1000], [0.1, 0.9]), crop=crop, voxel=0.3
    )
    specimen = recipe.specimen(entry=volume.origin + TURNED @ (10, 10, 11.5), axis=-TURNED[:, 2])
    burr = burrlab.Burr(2.4)
    run = burrlab.descend(burr, BONE, 1.0, specimen=specimen, seed=1, ideal=True)
    curve = burrlab.force_sweep(burr, BONE, [0.5, 1.0], specimen=specimen, seed=1)
    curve.to_csv(tmp_path / "curve.csv")
    settings = VoxelSettings(0.3, 1.0, False, specimen, 1).described()
    for kept in (
        run.provenance,
        curve.provenance,
        burrlab.VelocityCurve.from_csv(tmp_path / "curve.csv").provenance,
        settings,
    ):
        made = json.loads(json.dumps(kept["volume"]))
        assert made["map"] == recipe.mapping.text
        assert made["volume_spacing_mm"] == pytest.approx([0.4] * 3)
        assert made["voxel_mm"] == [0.3] * 3
        assert any(note.startswith("cropped to voxels") for note in made["notes"])
        assert VolumeRecipe.of(made["recipe"]) == recipe
        assert make_bone(made["recipe"]).digest() == specimen.bone.digest()


def test_what_is_assumed_is_said(tmp_path, capsys):
    """A file that does not say how it lies in the patient."""
    path = tmp_path / "ct.nrrd"
    values = np.full((12, 20, 20), 200, "u1")
    path.write_bytes(
        b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 20 20 12\nspacings: 0.5 0.5 0.5\nencoding: raw\n\n"
        + values.tobytes()
    )
    ask = [
        "--volume",
        str(path),
        "--map",
        "0:100",
        "--entry",
        "4.75,4.75,7",
        "--axis",
        "0,0,-1",
        "--seed",
        "1",
    ]
    for command in (
        ["descend", "--force", "1", "--ideal"],
        ["session", "--device", "hand", "--duration", "0.05", "--no-realtime"],
    ):
        assert main([*command, *ask, "--radius", "2.5"]) == 0
        said = capsys.readouterr().err
        assert "burrlab: the NRRD header" in said
        assert "L, P, S" in said


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
    try:
        code = main([*command, *words])
    except SystemExit as error:
        code = error.code
    assert code == 2
    assert message in capsys.readouterr().err


def test_a_session_in_a_resampled_volume(tmp_path, capsys):
    _, way = slab(tmp_path / "ct.nrrd")
    ask = [
        "session",
        "--device",
        "hand",
        "--duration",
        "0.3",
        "--seed",
        "1",
        "--radius",
        "2.5",
        "--no-realtime",
    ]
    ask += [
        "--volume",
        str(tmp_path / "ct.nrrd"),
        "--map",
        "-1000:0,0:0.5,1000:1",
        *way,
        "--record",
        str(tmp_path / "s.h5"),
    ]
    assert main([*ask, "--voxel", "0.3"]) == 0
    capsys.readouterr()
    trace = burrlab.load_trace(tmp_path / "s.h5")
    assert trace.bone().spacing == (0.3,) * 3
    recipe = json.loads(trace.source)
    assert recipe["map"] == [[-1000, 0], [0, 0.5], [1000, 1]]
    assert make_bone(recipe).digest() == trace.bone().digest()


def test_recipe_through_json(tmp_path):
    volume, _ = slab(tmp_path / "ct.nrrd")
    crop = (volume.origin.tolist(), (volume.origin + TURNED @ (9, 9, 9)).tolist())
    table = OccupancyMap.table([-1000, 1000], [0.1, 0.9])
    recipe = volume_recipe(tmp_path / "ct.nrrd", table, crop=crop, voxel=(0.2, 0.2, 0.3), spacing=0.4)
    again = VolumeRecipe.of(json.loads(json.dumps(recipe)))
    assert again.plain() == recipe
    bone = make_bone(json.loads(json.dumps(recipe)))
    direct = burrlab.read_volume(tmp_path / "ct.nrrd").crop(*crop).to_bone(table, spacing=(0.2, 0.2, 0.3))
    assert bone.digest() == direct.digest() == again.bone().digest()
    assert again.at(tmp_path / "ct.nrrd") == again
    with pytest.raises(ValueError, match="voxel must be a positive number or three"):
        volume_recipe("v.nrrd", 0, 1, voxel=0)
    with pytest.raises(ValueError, match="crop must be three finite numbers"):
        volume_recipe("v.nrrd", 0, 1, crop=((1, 2), (3, 4, 5)))
    with pytest.raises(TypeError, match="map must be an OccupancyMap or two grey values"):
        volume_recipe("v.nrrd", 0)


@pytest.mark.parametrize(
    "change",
    [
        {"map": []},
        {"map": [[0, 1]]},
        {"map": "ab"},
        {"voxel_mm": [1, 2]},
        {"crop_mm": [[1, 2, 3]]},
        {"path": 3},
        {"map": [1, 0]},
    ],
)
def test_recipe_that_cannot_be_read(change):
    with pytest.raises(ValueError, match="recipe must be that of block_recipe or volume_recipe, got"):
        make_bone({"kind": "volume", "path": "v.nrrd", "map": [0, 1], **change})


def test_a_stack_of_slices_as_a_recipe(tmp_path):
    image = pytest.importorskip("PIL.Image")
    folder = tmp_path / "slices"
    folder.mkdir()
    for k in range(4):
        image.fromarray(np.full((5, 6), 60 * k, np.uint8)).save(folder / f"slice{k}.png")
    bone = VolumeRecipe(folder, OccupancyMap.two_point(0, 255), spacing=(0.5, 0.5, 1)).bone()
    np.testing.assert_array_equal(bone.density[:, 0, 0], [0, 60, 120, 180])
    assert bone.spacing == (0.5, 0.5, 1.0)
    for k in range(4):
        image.fromarray(np.full((5, 6, 3), (0, 9, 60 * k), np.uint8)).save(folder / f"slice{k}.png")
    with pytest.raises(ValueError, match=r"colour|labels"):
        VolumeRecipe(folder, OccupancyMap.two_point(0, 255), spacing=0.5).bone()


@needs_hand
def test_a_real_ct_resampled_from_the_command_line(capsys):
    ask = [
        "descend",
        "--volume",
        str(HAND),
        "--map",
        "90:180",
        "--force",
        "0.3",
        "--entry",
        "65,50,103",
        "--axis",
        "0,1,0",
    ]
    ask += ["--ideal", "--seed", "1", "--crop", "58,45,96:72,80,110", "--json", "-"]
    assert main([*ask, "--radius", "1.5"]) == 2
    assert "--voxel 0.2 (voxel=0.2) makes finer ones" in capsys.readouterr().err
    assert main([*ask, "--radius", "1.5", "--voxel", "0.2"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["provenance"]["spacing_mm"] == [0.2] * 3
    assert not any(text.startswith("coarse") for text in result["warnings"])


@needs_hand
def test_a_real_ct_keeps_its_mass():
    part = burrlab.read_volume(HAND).crop((40, 40, 80), (90, 90, 120))
    mapping = OccupancyMap.two_point(90, 180)
    mass = part.to_bone(mapping).mass
    assert mass > 100
    for voxel, off in ((0.25, 1e-4), (0.2, 1e-3), (1.0, 1e-3)):
        assert part.to_bone(mapping, spacing=voxel).mass == pytest.approx(mass, rel=off)
