"""Bones from volumes: recipes in JSON, results and files, commands, descents, and blocks for experiments."""

import json

import numpy as np
import pytest
from command_line import result, said
from drilled_scenes import stack
from PIL import Image
from session_scenes import ended, refused, session_of

from burrlab import (
    Burr,
    OccupancyMap,
    ScriptedDevice,
    VelocityCurve,
    Volume,
    VoxelBone,
    VoxelEngine,
    descend,
    force_sweep,
    half_space,
    load_trace,
    materials,
    read_volume,
    session_metrics,
    write_volume,
)
from burrlab.bone.recipe import VolumeRecipe, cut_block, make_bone, volume_recipe
from burrlab.bone.specimen import Border
from burrlab.cli import main
from burrlab.psychophysics.protocol import Protocol
from burrlab.volume import load_drilled, save_drilled, write_dicom

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
from volume_scenes import ASKEW, slab

BONE = materials["bone"]
MAP = OccupancyMap.two_point(0, 1000)


def test_recipe_through_json(here):
    """Its path is absolute, as a replica seldom runs in the leader's folder; the file may be elsewhere there."""
    volume, _ = slab(here / "ct.nrrd")
    crop = (volume.origin.tolist(), (volume.origin + ASKEW @ (9, 9, 9)).tolist())
    table = OccupancyMap.table([-1000, 1000], [0.1, 0.9])
    recipe = volume_recipe("ct.nrrd", table, crop=crop, voxel=(0.2, 0.2, 0.3), spacing=0.4)
    assert recipe["path"] == str(here / "ct.nrrd")
    again = VolumeRecipe.of(json.loads(json.dumps(recipe)))
    assert again.plain() == recipe
    direct = read_volume("ct.nrrd").crop(*crop).to_bone(table, spacing=(0.2, 0.2, 0.3))
    assert make_bone(json.loads(json.dumps(recipe))).digest() == direct.digest() == again.bone().digest()
    assert again.at(here / "ct.nrrd") == again
    moved = (here / "ct.nrrd").rename(here / "moved.nrrd")
    assert make_bone(recipe, volume=moved).digest() == direct.digest()
    refused((lambda: make_bone(recipe), r"ct\.nrrd: no such file", FileNotFoundError))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"voxel": 0}, "voxel must be a number or three from 1e-6 to 1e6"),
        ({"crop": ((1, 2), (3, 4, 5))}, "crop must be three finite numbers"),
        ({"mapping": 0}, "map must be an OccupancyMap, such as"),
    ],
)
def test_parameters_that_are_wrong(options, match):
    refused((lambda: volume_recipe("v.nrrd", **{"mapping": MAP, **options}), match, (ValueError, TypeError)))


def test_a_picture_among_dicom_slices_is_ignored(tmp_path):
    values = np.full((3, 4, 5), 100, np.int16)
    write_dicom(tmp_path / "ct", Volume(values, (0.2, 0.3, 0.4), (0, 0, 0), np.eye(3), "made"))
    Image.fromarray(np.zeros((4, 5), np.uint8)).save(tmp_path / "ct" / "preview.png")
    found = VolumeRecipe(tmp_path / "ct", MAP).volume()
    np.testing.assert_array_equal(found.values, values)
    save_drilled(tmp_path / "kept", found.to_bone(MAP), found, mapping=MAP)
    assert read_volume(tmp_path / "kept").shape == (3, 4, 5)
    assert load_drilled(tmp_path / "kept").bone.digest() == found.to_bone(MAP).digest()


def test_results_keep_how_the_bone_was_made(tmp_path):
    """Descent, curve and fit keep map, voxels and crop, also in files."""
    volume, _ = slab(tmp_path / "ct.nrrd")
    crop = (volume.origin.tolist(), (volume.origin + ASKEW @ (19, 19, 11)).tolist())
    recipe = VolumeRecipe(
        tmp_path / "ct.nrrd", OccupancyMap.table([-1000, 1000], [0.1, 0.9]), crop=crop, voxel=0.3
    )
    specimen = recipe.specimen(entry=volume.origin + ASKEW @ (10, 10, 11.5), axis=-ASKEW[:, 2])
    burr = Burr(2.4)
    run = descend(burr, BONE, 1.0, specimen=specimen, seed=1, ideal=True)
    curve = force_sweep(burr, BONE, [0.5, 1.0], specimen=specimen, seed=1)
    curve.to_csv(tmp_path / "curve.csv")
    for kept in (
        run.provenance,
        curve.provenance,
        VelocityCurve.from_csv(tmp_path / "curve.csv").provenance,
        VoxelEngine(voxel=0.3, specimen=specimen)._described(),
    ):
        made = json.loads(json.dumps(kept["volume"]))
        assert made["map"] == recipe.mapping.text
        assert made["volume_spacing_mm"] == pytest.approx([0.4] * 3)
        assert made["voxel_mm"] == [0.3] * 3
        assert any(note.startswith("cropped to voxels") for note in made["notes"])
        assert VolumeRecipe.of(made["recipe"]) == recipe
        assert make_bone(made["recipe"]).digest() == specimen.bone.digest()


def test_a_clinical_volume_resampled_from_the_command_line(tmp_path, capsys):
    volume, way = slab(tmp_path / "ct.nrrd")
    grey = ["--volume", tmp_path / "ct.nrrd", "--map", "-1000:1000"]
    ask = ["descend", "--force", "0.3", "--radius", "1", "--ideal", "--seed", "1", *way, *grey]
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
    direct = descend(
        Burr(1.0), BONE, 0.3, specimen=fine.specimen(OccupancyMap.two_point(-1000, 1000), entry=fine.origin + ASKEW @ (10, 10, 11.5),
        axis=-ASKEW[:, 2]), seed=1, ideal=True,
    )  # fmt: skip
    # The interpolated rim is 0.4 mm wide and the burr meets less bone at first: velocities are only similar.
    assert sunk["penetration_velocity_mm_s"] == pytest.approx(direct.penetration_velocity, rel=0.3)


def test_an_assumed_orientation_is_printed(tmp_path, capsys):
    """The file has no orientation in the patient."""
    head = b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 20 20 12\nspacings: 0.5 0.5 0.5\nencoding: raw\n\n"
    (tmp_path / "ct.nrrd").write_bytes(head + bytes([200]) * 4800)
    ask = [
        "--volume", tmp_path / "ct.nrrd", "--map", "0:100", "--seed", "1", "--radius", "2.5",
        "--entry", "4.75,4.75,7", "--axis", "0,0,-1",
    ]  # fmt: skip
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


# --- Descents into volumes whose voxels are no cubes, and into rotated ones ------------------------------


BURR = Burr(3.0)
PERMUTED = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # left-handed


def half_space_volume(voxel, axis, direction):
    """Volume with the bone of `half_space`, and entry and axis in its coordinates."""
    made = half_space(BURR, voxel, axis=axis, offset=(0.03, 0.04, 0.02))
    bone = made.bone
    volume = Volume(bone.density, bone.spacing, direction @ bone.origin, direction, "half-space")
    return volume, {"entry": direction @ (made.surface - 5 * made.axis), "axis": direction @ made.axis}


def descent(volume, way, force=1.0, path=None):
    """A descent into a volume, after writing and reading it if a path is given."""
    if path is not None:
        write_volume(path, volume)
        volume = read_volume(path)
    specimen = volume.specimen(OccupancyMap.two_point(0, 255), **way)
    return descend(BURR, BONE, force, specimen=specimen, seed=1, ideal=True)


@pytest.fixture(scope="module")
def straight():
    return descent(*half_space_volume(0.1, (0, 0, -1), np.eye(3)))


@pytest.mark.parametrize(
    ("axis", "force"), [((0, 0, -1), 1.0), ((-1, 0, 0), 2.0), ((1, 1, -1), 2.0), ((1, 2, 3), 1.0)]
)
def test_anisotropic_equals_isotropic(tmp_path, axis, force):
    found = [
        descent(*half_space_volume(voxel, axis, np.eye(3)), force, tmp_path / name).penetration_velocity
        for name, voxel in (("a.nrrd", 0.1), ("b.nii.gz", (0.1, 0.1, 0.2)))
    ]
    assert found[1] == pytest.approx(found[0], rel=0.05)  # measured: at most 1.7 %


@pytest.mark.parametrize("direction", [PERMUTED, np.diag([1.0, 1.0, -1.0])], ids=["permuted", "mirrored"])
def test_permuted_and_mirrored_volumes_give_the_same_bits(tmp_path, straight, direction):
    run = descent(*half_space_volume(0.1, (0, 0, -1), direction), path=tmp_path / "v.nrrd")
    np.testing.assert_array_equal(run.immersion, straight.immersion)
    np.testing.assert_array_equal(run.force, straight.force)


@pytest.mark.parametrize(("name", "direction"), [("v.nrrd", ASKEW), ("v.mha", ASKEW * (1, 1, -1))])
def test_a_turned_volume_gives_the_same_within_rounding(tmp_path, straight, direction, name):
    run = descent(*half_space_volume(0.1, (0, 0, -1), direction), path=tmp_path / name)
    # Rounding of the entry may change the loss of a voxel by one level; measured: 2e-6 mm.
    np.testing.assert_allclose(run.immersion, straight.immersion, rtol=0, atol=2e-5)
    assert run.penetration_velocity == pytest.approx(straight.penetration_velocity, rel=1e-4)


def test_bone_that_ends_with_the_volume_has_its_surface_at_the_face():
    volume, way = half_space_volume((0.1, 0.1, 0.4), (0, 0, -1), np.eye(3))
    assert volume.specimen(OccupancyMap.two_point(0, 255), **way).surface[2] == pytest.approx(
        0.0, abs=0.01 * 0.4
    )


def test_bone_that_is_cut_open_at_the_border_gets_a_note(tmp_path):
    values = np.zeros((40, 60, 60), np.int16)
    values[:30] = 1000
    slab = Volume(values, (0.15, 0.15, 0.15), (0, 0, 0), np.eye(3), "slab")
    burr, said, mapping = Burr(2.0), [], OccupancyMap.two_point(0, 1000)
    for x in (4.5, 0.825):  # in the middle, and 0.9 mm from the border
        specimen = slab.specimen(mapping, entry=(x, 4.5, 5.9), axis=(0, 0, -1))
        run = descend(burr, BONE, 0.5, specimen=specimen, ideal=True, seed=1)
        path, device = tmp_path / f"{x}.h5", ScriptedDevice([0, 0.2], [(x, 4.5, 6.6), (x, 4.5, 5.6)])
        options = {"seed": 1, "duration": 0.2, "wall_clock": False, "record": path}
        session = ended(session_of(slab.to_bone(mapping), (burr, BONE), device, **options))
        metrics = session_metrics(load_trace(path))
        assert (run.status, session.messages) == ("ok", list(session.report().messages))
        assert metrics.to_dict().get("notes", []) == list(metrics.notes)
        assert all(note in str(metrics) for note in metrics.notes)
        said.append([len(texts) for texts in (run.warnings, session.messages, metrics.notes)])
    assert said == [[0, 0, 0], [1, 1, 1]]
    ticks = len(run.time)
    assert run.warnings[0].endswith(
        f"out of the volume through bone, and sinks faster without the bone beyond ({ticks} of {ticks} ticks)"
    )
    assert session.messages[0].startswith("burr 0: border: the burr reached out")


def test_the_face_through_which_a_burr_comes_in_is_no_border():
    border = Border(VoxelBone.block((4, 4, 4), 0.2))  # from -0.1 to 3.9 mm
    down = np.column_stack([np.full(50, 2.0), np.full(50, 2.0), np.linspace(5, 1.2, 50)])
    assert border.count_cut(down, 1.2) == 0
    assert border.count_cut(np.array([[2.0, 2.0, 3.5], [2.0, 1.2, 2.0]]), 1.2) == 0  # it is still inside
    assert border.count_cut(np.array([[2.0, 2.0, 1.0], [1.0, 2.0, 2.0], [2.0, -0.2, 2.0]]), 1.2) == 2
    assert border.count_cut(np.array([[2.0, 0.2, 2.0], [2.0, 2.0, 3.5]]), 1.2) == 1
    assert border.count_cut(np.zeros((0, 3)), 1.2) == 0


# --- Blocks for experiments ---------------------------------------------------------------------------------


PROTOCOL = """
[experiment]
name = "volume"
seed = 3
subjects = 1
[burr]
radius_mm = 2.0
[bone]
size_mm = [12, 12, 6]
voxel_mm = 0.5
volume = "ct.nrrd"
map = "0:1000"
entry_mm = {entry}
axis = {axis}
[tasks.probing]
design = "same-different"
a = "bone"
b = "pvc"
mode = "probing"
trials = 4
interval_s = 1.0
"""


@pytest.fixture
def volume(tmp_path):
    """A rotated volume, solid up to z = 8 mm of 12 except for a hole on the way down."""
    values = np.zeros((24, 40, 40), np.int16)
    values[:16] = 1000
    values[4:8, 18:22, 18:22] = 0
    volume = Volume(values, (0.5, 0.5, 0.5), (10, 20, 30), ASKEW, "made")
    write_volume(tmp_path / "ct.nrrd", volume)
    return volume


def way(volume):
    return {"entry": (volume.origin + ASKEW @ (9.75, 9.75, 11)).tolist(), "axis": (-ASKEW[:, 2]).tolist()}


def test_a_block_is_the_volume_below_the_entry(tmp_path, volume):
    block = cut_block(VolumeRecipe(tmp_path / "ct.nrrd", MAP), (6, 6, 7.5), 0.5, **way(volume))
    assert (block.shape, block.origin) == ((15, 12, 12), (-2.75, -2.75, -7.25))
    levels = block.density
    for solid in (levels[7:], levels[:3]):  # above and below the hole
        assert solid.min() >= 250
    assert levels[3:7, 4:8, 4:8].max() <= 5  # the hole, 4 to 6 mm below the surface, about the axis
    assert (255 - levels.astype(float)).sum() / 255 * 0.125 == pytest.approx(4 * 4 * 4 * 0.125, rel=0.05)


def test_a_block_across_an_oblique_axis_is_flat_on_top(tmp_path, volume):
    axis = -ASKEW @ (0.3, 0.2, 1)
    block = cut_block(
        VolumeRecipe(tmp_path / "ct.nrrd", MAP, voxel=0.25), (4, 4, 2), 0.25, **{**way(volume), "axis": axis}
    )
    assert 100 < block.density[-1, 7:9, 7:9].mean() < 255  # the top is at the surface
    tilt = block.density[-4].astype(float)
    assert tilt.min() < 250 < tilt.max() + 6  # the bone is tilted to the axis


@pytest.mark.parametrize(
    ("size", "voxel", "axis", "match"),
    [
        ((6, 6, 0), 0.5, -1, "size must be a number or three from 1e-6 to 1e6"),
        ((60, 100, 1), 1e-3, -1, r"voxel must be coarser: the block has 6e\+12 voxels"),
        ((6, 6, 6), 0.5, 1, "meets no occupancy of 128"),
    ],
)
def test_block_errors(tmp_path, volume, size, voxel, axis, match):
    recipe, place = VolumeRecipe(tmp_path / "ct.nrrd", MAP), {**way(volume), "axis": axis * ASKEW[:, 2]}
    refused((lambda: cut_block(recipe, size, voxel, **place), match))


def protocol(tmp_path, volume, old="", new=""):
    path = tmp_path / "experiment.toml"
    path.write_text(PROTOCOL.format(**way(volume)).replace(old, new), encoding="utf-8")
    return path


def test_a_protocol_with_a_volume_runs(tmp_path, volume):
    path = protocol(tmp_path, volume)
    one = Protocol.read(path)
    again = make_bone(json.loads(json.dumps(one.bone.recipe())))
    assert again.digest() == one.bone.fresh().digest() == one.bone.plain()["digest"]
    assert one.bone.plain()["volume"]["path"] == "ct.nrrd"
    assert main(["experiment", "run", str(path), "--simulated", "--subject", "01", "--fast"]) == 0
    assert one.data.answers("01", "probing").exists()
    # Another volume and map change the digest; another folder does not.
    (elsewhere := tmp_path / "elsewhere").mkdir()
    for values, alike in ((volume.values, True), (volume.values // 2, False)):
        write_volume(elsewhere / "ct.nrrd", Volume(values, volume.spacing, volume.origin, ASKEW, "made"))
        other = protocol(elsewhere, volume, '"0:1000"', '"0:1000"' if alike else '"0:900"')
        assert (Protocol.read(other).digest == one.digest) is alike


def test_slices_in_a_protocol(tmp_path):
    """A block of slices; the digest of the protocol counts `transpose` only where it is true."""
    planes = np.zeros((24, 40, 44), np.uint8)
    planes[:16] = 200
    stack(tmp_path / "ct", planes)
    text = PROTOCOL.replace('"ct.nrrd"', '"ct"\nspacing_mm = [0.5, 0.5, 0.5]').replace("0:1000", "0:100")
    text = text.replace("{axis}\n", "[0, 0, -1]\n{more}").replace("{entry}", "[9, 9, 11]")
    for more, told in (("", None), ("transpose = false\n", None), ("transpose = true\n", True)):
        (tmp_path / "experiment.toml").write_text(text.format(more=more))
        bone = Protocol.read(tmp_path / "experiment.toml").bone
        assert bone.plain()["volume"].get("transpose") is told
        assert bone.recipe()["volume"]["transpose"] is bool(told)
        assert bone.recipe()["notes"][0] == "PNG slices say no orientation: LPS assumed"
        assert "notes" not in bone.plain()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('volume = "ct.nrrd"\n', "", r", \[bone\]: map goes with volume"),
        ('map = "0:1000"\n', "", r", \[bone\]: map is missing: volume needs it"),
        ('"0:1000"', '"5"', r", \[bone\]: must be LO:HI or GREY:OCCUPANCY"),
        ("ct.nrrd", "none.nrrd", r", \[bone\]: .*none\.nrrd: no such file"),
        (
            'map = "0:1000"\n',
            'map = "0:1000"\ntranspose = 1\n',
            r", \[bone\]: transpose must be true or false, got 1",
        ),
        ('map = "0:1000"\n', 'map = "0:1000"\ncrop_mm = 3\n', r", \[bone\]: crop_mm must be two corners"),
        (
            'map = "0:1000"\n',
            'map = "0:1000"\nspacing_mm = [1, 1, 1]\n',
            r", \[bone\]: .*spacing must be that of the file",
        ),
        (
            'map = "0:1000"\n',
            'map = "1000:2000"\n',
            r", \[bone\]: entry: the axis from .* meets no occupancy of 128",
        ),
    ],
)
def test_wrong_protocols(tmp_path, volume, old, new, message):
    refused((lambda: Protocol.read(protocol(tmp_path, volume, old, new)), message))
