"""Experiments on a block cut from a volume."""

import json

import numpy as np
import pytest
from PIL import Image
from volume_scenes import ASKEW

from burrlab import OccupancyMap, Volume, write_volume
from burrlab.bone.recipe import VolumeRecipe, cut_block
from burrlab.cli import main
from burrlab.psychophysics.protocol import Protocol
from burrlab.session.network import make_bone

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")

MAP = OccupancyMap.two_point(0, 1000)

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
        ((6, 6, 0), 0.5, -1, "size must be a positive number or three"),
        ((60, 100, 1), 1e-3, -1, r"voxel must be coarser: the block has 6e\+12 voxels"),
        ((6, 6, 6), 0.5, 1, "meets no occupancy of 128"),
    ],
)
def test_block_errors(tmp_path, volume, size, voxel, axis, match):
    recipe, place = VolumeRecipe(tmp_path / "ct.nrrd", MAP), {**way(volume), "axis": axis * ASKEW[:, 2]}
    with pytest.raises(ValueError, match=match):
        cut_block(recipe, size, voxel, **place)


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
    (tmp_path / "ct").mkdir()
    for k in range(24):
        Image.fromarray(np.full((40, 44), 200 if k < 16 else 0, np.uint8)).save(tmp_path / "ct" / f"s{k}.png")
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
    with pytest.raises(ValueError, match=message):
        Protocol.read(protocol(tmp_path, volume, old, new))
