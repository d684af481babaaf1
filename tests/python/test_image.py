"""Volumes on a grid: crop, resampling, labels of another grid or on it, specimens, occupancy maps; refusals."""

import numpy as np
import pytest
from label_scenes import MAP, TABLE, anatomy_bone, labels, volume
from session_scenes import refused
from volume_scenes import TURNED

import burrlab
from burrlab.bone.image import LabelVolume, OccupancyMap, Volume, check_same_geometry, same_geometry
from burrlab.bone.recipe import LabelledRecipe, VolumeRecipe, make_bone
from burrlab.bone.tissues import default_tissues

UNIT = OccupancyMap.two_point(0, 1)


def sphere(spacing, radius=4.0, soft=0.0, side=12.0):
    """A sphere of grey 1000 in a cube of 0 about the origin, with a rim that falls over `soft` mm."""
    spacing = np.broadcast_to(np.asarray(spacing, dtype=float), (3,))
    count = np.round(side / spacing).astype(int)
    axes = [(np.arange(n) + 0.5) * s - side / 2 for n, s in zip(count, spacing, strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    part = np.clip((radius - np.sqrt(x**2 + y**2 + z**2)) / max(soft, 1e-9) + 0.5, 0, 1)
    return Volume(np.rint(1000 * part).T.astype(np.int16), spacing, [a[0] for a in axes], np.eye(3), "sphere")


@pytest.mark.parametrize("old", [0.4, (0.4, 0.3, 0.6)])
@pytest.mark.parametrize("new", [0.1, 0.2, 0.13, 0.17, (0.1, 0.2, 0.3), 0.7, 1.2, (0.1, 0.9, 0.25)])
def test_mass_is_kept(old, new):
    """Mass of a sharp sphere: within 0.1 % at any ratio; exact at whole ratios but for rounding to levels."""
    volume, mapping = sphere(old), OccupancyMap.two_point(0, 1000)
    ratios = volume.spacing / np.broadcast_to(new, 3)
    whole = np.allclose(ratios, np.round(ratios)) and np.all(ratios > 0.99)
    mass = volume.to_bone(mapping).mass
    assert volume.to_bone(mapping, spacing=new).mass == pytest.approx(mass, rel=1e-4 if whole else 1e-3)


def test_resampled_where_the_map_bends():
    """A two-point map of a steep rim keeps the amount of bone, as the map acts first; grey values do not."""
    volume, mapping = sphere(0.4, soft=0.4), OccupancyMap.two_point(600, 700)
    before = volume.to_bone(mapping).mass
    assert volume.to_bone(mapping, spacing=0.1).mass == pytest.approx(before, rel=1e-4)
    assert volume.resample(0.1).to_bone(mapping).mass == pytest.approx(before, rel=0.1)


def test_linear_values_are_kept_when_finer():
    z, y, x = np.meshgrid(*(np.arange(n, dtype=float) for n in (5, 6, 7)), indexing="ij")
    volume = Volume(x + 10 * y + 100 * z, (0.4, 0.6, 0.8), (0, 0, 0), np.eye(3), "ramp")
    fine = volume.resample((0.2, 0.2, 0.2))
    assert fine.shape == (20, 18, 14)
    np.testing.assert_allclose(fine.origin, (-0.1, -0.2, -0.3))
    centers = [np.arange(n) * 0.2 + o for n, o in zip(fine.shape[::-1], fine.origin, strict=True)]
    inside = [np.clip(c / s, 0, n - 1) for c, s, n in zip(centers, volume.spacing, (7, 6, 5), strict=True)]
    np.testing.assert_allclose(
        fine.values, inside[0] + 10 * inside[1][:, None] + 100 * inside[2][:, None, None], atol=1e-4
    )


def test_coarser_is_the_mean():
    values = np.random.default_rng(4).random((4, 6, 5))
    coarse = Volume(values, (0.1, 0.1, 0.1), (0, 0, 0), np.eye(3), "noise").resample((0.25, 0.3, 0.2))
    assert coarse.shape == (2, 2, 2)
    weights = np.array([[1, 1, 0.5, 0, 0], [0, 0, 0.5, 1, 1]]) / 2.5
    np.testing.assert_allclose(
        coarse.values, np.einsum("zaybx,kx->zyk", values.reshape(2, 2, 2, 3, 5), weights) / 6, rtol=1e-6
    )


def test_no_aliasing():
    """Walls of one voxel in three: larger voxels hold a third, wherever they lie."""
    values = np.zeros((6, 6, 60))
    values[:, :, ::3] = 255
    volume = Volume(values, (0.1, 0.1, 0.1), (0, 0, 0), np.eye(3), "walls")
    assert volume.resample((0.6, 0.1, 0.1)).values == pytest.approx(85.0)


@pytest.mark.parametrize("new", [0.1, 0.25, 0.7, (0.1, 0.3, 0.2)])
def test_field_of_view(new):
    place = (0.3, 0.3, 0.5), (1, 2, 3), TURNED
    volume = Volume(np.ones((7, 8, 9)), *place, "ones")
    finer, bone = volume.resample(new), volume.to_bone(UNIT, spacing=new)
    low = volume.bone_point(volume.origin) - volume.spacing / 2
    np.testing.assert_allclose(finer.bone_point(finer.origin) - finer.spacing / 2, low, atol=1e-12)
    sides, finer_sides = (each.spacing * each.shape[::-1] for each in (volume, finer))
    assert np.all(finer_sides >= sides - 1e-6 * finer.spacing)
    assert np.all(finer_sides < sides + finer.spacing)
    assert same_geometry(finer, LabelVolume(np.ones((7, 8, 9), int), *place, "labels").resample(new))
    assert bone.shape == finer.shape
    np.testing.assert_allclose(bone.origin, finer.bone_point(finer.origin))


@pytest.mark.parametrize("new", [0.7, (0.25, 0.7, 1.1), 0.33])
def test_bone_ends_with_the_volume(new):
    """Bone is solid up to the faces; a voxel that reaches beyond them holds its part within."""
    bone = Volume(np.ones((7, 8, 9)), (0.3, 0.3, 0.5), (0, 0, 0), np.eye(3), "ones").to_bone(
        UNIT, spacing=new
    )
    assert bone.mass == pytest.approx(7 * 8 * 9 * 0.045, rel=5e-3)


def test_labels_nearest():
    labels = np.random.default_rng(5).integers(0, 40, (4, 5, 6)).astype(np.uint16)
    volume = LabelVolume(labels, (0.4, 0.4, 0.4), (0, 0, 0), np.eye(3), "labels", names={3: "dura"})
    fine, odd = volume.resample(0.2), volume.resample(0.15)
    np.testing.assert_array_equal(fine.labels, labels.repeat(2, 0).repeat(2, 1).repeat(2, 2))
    assert (fine.labels.dtype, fine.names) == (np.uint16, {3: "dura"})
    places = [np.floor((np.arange(n) + 0.5) * 0.15 / 0.4).astype(int).clip(max=m - 1) for n, m in zip(odd.shape, labels.shape, strict=True)]  # fmt: skip
    np.testing.assert_array_equal(odd.labels, labels[np.ix_(*places)])
    np.testing.assert_array_equal(fine.resample(0.4).labels, labels)  # on a face: the lower voxel


def test_spacing_in_single_precision_makes_the_same_grid(tmp_path):
    """NIfTI's 0.3 mm is 0.30000001 mm: grey values and labels in different formats stay on one grid."""
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    values = np.full((38, 62, 47), 1000, np.int16)
    grey = Volume(values, (0.3, 0.3, 0.5), (0, 0, 0), np.eye(3), "grey")
    labels = LabelVolume(np.ones(values.shape, np.uint8), grey.spacing, grey.origin, np.eye(3), "labels")
    burrlab.write_volume(tmp_path / "labels.nii", labels)
    read = burrlab.volume.read_labels(tmp_path / "labels.nii")
    assert read.spacing[0] != grey.spacing[0]
    assert read.resample(0.2).shape == grey.resample(0.2).shape == (95, 93, 71)
    made = anatomy_bone(
        grey, read, default_tissues({1: "bone"}), mapping=OccupancyMap.two_point(0, 1000), spacing=0.2
    )
    assert made.shape == (95, 93, 71)
    np.testing.assert_array_equal(made.density[:-1, :-1, :-1], 255)


def test_the_same_spacing_changes_nothing():
    volume = sphere(0.4)
    assert volume.resample(0.4) is volume
    assert volume.to_bone(UNIT, spacing=0.4).digest() == volume.to_bone(UNIT).digest()


def test_crop():
    values = np.arange(4 * 5 * 6).reshape(4, 5, 6)
    volume, low, high = grey(values=values), (10.6, 20.5, 31.0), (12.0, 21.4, 99)
    part = volume.crop(low, high)
    np.testing.assert_array_equal(part.values, values[1:, 1:3, 2:5])
    np.testing.assert_array_equal(part.origin, (11, 20.5, 31))
    assert "cropped to voxels (1, 1, 2) to (4, 3, 5) (z, y, x) of (4, 5, 6)" in part.notes
    np.testing.assert_array_equal(volume.crop(high, low).values, part.values)
    for same in (volume.crop_voxels((1, 1, 2), (4, 3, 5)), numbered(values).crop(low, high)):
        assert same_geometry(part, same)
    assert volume.crop((-1e300, -1e300, -1e300), (1e300, 1e300, 1e300)).shape == volume.shape


def test_crop_of_a_turned_volume_keeps_the_whole_box():
    volume = Volume(np.ones((30, 30, 30)), (0.5, 0.5, 0.5), (0, 0, 0), TURNED, "v")
    low, high = np.array(volume.patient_point((5, 5, 5))) - 1, np.array(volume.patient_point((5, 5, 5))) + 1
    part = volume.crop(low, high)
    first = part.bone_point(part.origin)
    last = first + (np.array(part.shape[::-1]) - 1) * part.spacing
    for corner in np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3):
        assert np.all(part.bone_point(corner) >= first - 0.5)
        assert np.all(part.bone_point(corner) <= last + 0.5)


GRID = {"spacing": (0.5, 0.5, 1.0), "origin": (10, 20, 30), "direction": np.eye(3)}


def grey(**changes):
    return Volume(**{"values": np.ones((4, 5, 6)), **GRID, "path": "v", **changes})


ONES = np.ones((2, 2, 2), int)


def numbered(labels=ONES, **changes):
    return LabelVolume(labels, **{**GRID, "path": "l", **changes})


def slab():
    """200 below index 15 along z, 20 above; spacing 0.3 mm."""
    values = np.full((30, 40, 40), 20, np.uint8)
    values[:15] = 200
    return Volume(values, 0.3, (5.0, -7.0, 11.0), np.eye(3), "v.nrrd")


def specimen(entry, axis=(0, 0, -1), grey_values=(60, 160)):
    volume = slab()
    return volume.specimen(
        OccupancyMap.two_point(*grey_values),
        entry=np.multiply(volume.origin + entry[:3], entry[3:] or 1),
        axis=axis,
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        # Geometry that differs.
        (lambda: check_same_geometry(grey(), grey(values=np.ones((4, 5, 7)))),
         "v and v must have the same geometry: 6 x 5 x 4 voxels against 7 x 5 x 4"),
        (lambda: check_same_geometry(grey(), grey(spacing=(0.5, 0.5, 1.01))), r"spacing \(0\.5, 0\.5, 1\) against \(0\.5, 0\.5, 1\.01\) mm"),
        (lambda: check_same_geometry(grey(), grey(origin=(10, 20.1, 30))), r"origin \(10, 20, 30\) against \(10, 20\.1, 30\) mm"),
        (lambda: check_same_geometry(grey(), grey(direction=np.diag([1, -1, 1]))), r"directions \(1, 0, 0\), .* against \(1, 0, 0\), \(0, -1, 0\)"),
        # Volumes and labels.
        (lambda: grey(values=np.ones((4, 5))), "values must be numbers in three dimensions"),
        (lambda: grey(values=np.ones((2, 2, 2), dtype=complex)),
         "values must be numbers in three dimensions"),
        (lambda: grey(values=np.full((2, 2, 2), np.inf)), r"not finite: 8 of 8, the first at \(z, y, x\) = \(0, 0, 0\)"),
        (lambda: grey(spacing=(1, 1, 0)), "spacing must be a number or three from 1e-6 to 1e6"),
        (lambda: grey(origin=(1, 1)), "origin must be three finite numbers"),
        (lambda: grey(direction=np.eye(3) * 2), "not orthonormal"),
        (lambda: grey(direction=np.eye(2)), "direction matrix must be of 3 x 3 finite numbers"),
        (lambda: numbered(np.ones((2, 2))), "l: labels must be whole numbers in three dimensions"),
        (lambda: numbered(colours={1: (0, 0, 256)}), "colours must be of channels 0 to 255"),
        (lambda: grey().values.__setitem__(0, 2), "read-only"),
        (lambda: numbered().labels.__setitem__(0, 2), "read-only"),
        # Boxes.
        (lambda: grey().crop((0, 0, 0), (5, 5, 5)), r"holds no voxel of v, which lies between \(10, 20, 30\) and \(12\.5, 22, 33\) mm"),
        (lambda: grey().crop((1e300, 0, 0), (2e300, 99, 99)), "holds no voxel of v"),
        (lambda: grey().crop((0, 0, np.nan), (1, 1, 1)), "low must be three finite numbers"),
        (lambda: grey().crop_voxels((0, 0, 0), (4, 5, 7)), r"must be a box of voxels \(z, y, x\) in \(4, 5, 6\), got \(0, 0, 0\) to \(4, 5, 7\)"),
        # Spacing.
        (lambda: grey().resample(1e-6),
         "spacing must be coarser or the volume cropped: .* makes .* voxels"),
        (lambda: sphere(0.6).resample(0.001), r"or the volume cropped: 0\.001 mm makes .* voxels, and 2e\+08"),
        (lambda: grey().resample(1e308), "spacing must be a number or three from 1e-6 to 1e6"),
        # Labels that lie elsewhere: RAS read as LPS.
        (lambda: numbered().on(grey(origin=(-10, -20, 30))), r"labels must overlap the volume: those of l lie between \(10, 20, 30\) and "
         r"\(10.5, 20.5, 31\) mm, and v between \(-10, -20, 30\) and \(-7.5, -18, 33\) mm"),
        # Specimens.
        (lambda: specimen((6, 6, 8), axis=(0, 0, 1)), r"meets no occupancy of 128 in v.nrrd, whose grey values are 20 to 200; the volume lies "
         r"from .* to .* mm, x to the left, y to the back \(LPS\)$"),
        (lambda: specimen((6, 6, 6, -1, -1, 1)), r"\(LPS\); .* lies in it: RAS, as 3D Slicer shows"),
        (lambda: specimen((6, 6, 108)), r"entry: .* lies \d+ mm outside v.nrrd, more than it is wide; the volume lies"),
        (lambda: specimen((6, 6, 1)), "lies inside bone"),
        (lambda: specimen((6, 6, 8), axis=(0, 0, 0)), "axis must be three finite numbers"),
        # Maps.
        (lambda: specimen((6, 6, 8), grey_values=(160, 60)), "LO:HI with LO below HI, got 160:60"),
        (lambda: OccupancyMap.two_point(0, np.nan), "LO:HI with LO below HI"),
        (lambda: OccupancyMap.table([1], [0]), "two points or more"),
        (lambda: OccupancyMap.table([1, 2], [0]), "two points or more, .* got 2 and 1"),
        (lambda: OccupancyMap.table([1, 1], [0, 1]), "finite, increasing grey values"),
        (lambda: OccupancyMap.table([1, np.inf], [0, 1]), "finite, increasing grey values"),
        (lambda: OccupancyMap.table([1, 2], [0, 1.5]), "occupancies within 0 to 1"),
        (lambda: OccupancyMap.parse("1:2:3"), "must be LO:HI or GREY:OCCUPANCY"),
        (lambda: OccupancyMap.two_point(0, 1).levels(np.array([0.5, np.nan])), "values must be finite"),
        (lambda: grey().to_bone(5), "map must be an OccupancyMap, such as .*, got 5"),
    ],
)  # fmt: skip
def test_refusals(make, message):
    refused((make, message, (ValueError, TypeError)))


def test_geometry_and_points():
    assert [same_geometry(grey(), grey(origin=(10, 20 + by, 30))) for by in (0, 0.1)] == [True, False]
    volume = grey(direction=TURNED)
    np.testing.assert_allclose(volume.patient_point(volume.bone_point((4, 5, 6))), (4, 5, 6), atol=1e-14)
    assert numbered(np.ones((2, 2, 2), bool)).labels.dtype == np.uint8


@pytest.mark.parametrize("far", [8.0, 18.0])
def test_entry_counts_from_first_crossing_of_occupancy_128(far):
    # Occupancy falls from 255 to 0 between the centres of layers 14 and 15.
    assert specimen((6, 6, far)).surface[2] == pytest.approx(11 + 0.3 * (15 - 128 / 255), abs=1e-3)


def test_two_point_map():
    values = np.array([-100, 90, 91, 135, 179, 180, 30000])
    wanted = [0, 0, 3, 128, 252, 255, 255]
    for kind in (np.int16, np.int32, np.float32, np.float64):
        np.testing.assert_array_equal(OccupancyMap.two_point(90, 180).levels(values.astype(kind)), wanted)
    values = np.random.default_rng(3).integers(-2000, 3000, 5000).astype(np.int16)
    wanted = np.rint(255 * np.clip((values - 150.0) / (1250.0 - 150.0), 0, 1))
    np.testing.assert_array_equal(OccupancyMap.two_point(150, 1250).levels(values), wanted)


def test_map_by_a_table():
    table = OccupancyMap.table([-10, 0, 10, 30], [0.2, 1.0, 0.0, 0.5])
    values = np.array([-50, -10, -5, 0, 5, 10, 20, 30, 99])
    wanted = np.interp(values, table.greys, table.occupancies)
    for kind in (np.float64, np.int8):
        np.testing.assert_allclose(table.occupancy(values.astype(kind)), wanted, atol=1e-7)
    assert OccupancyMap.parse(table.text) == table
    assert OccupancyMap.parse("90:180") == OccupancyMap.two_point(90, 180)


# ---- labels on the voxels of another volume ----

TURN = np.array([[0.36, -0.48, 0.8], [0.8, 0.6, 0.0], [-0.48, 0.64, 0.6]])  # orthonormal


def random(spacing: tuple[float, float, float], direction: np.ndarray | None = None) -> LabelVolume:
    values = np.random.default_rng(4).integers(0, 9, (9, 10, 11)).astype(np.uint16)
    return LabelVolume(
        values, spacing, (4.0, -5.0, 6.0), np.eye(3) if direction is None else direction, "random", {3: "x"}
    )


def grid_of(labels: LabelVolume, **changes: object) -> Volume:
    place = {"spacing": labels.spacing, "origin": labels.origin, "direction": labels.direction, **changes}
    return Volume(np.zeros(place.pop("shape", labels.shape)), path="grid", **place)  # type: ignore[arg-type]


@pytest.mark.parametrize("direction", [np.eye(3), TURN])
@pytest.mark.parametrize("spacing", [0.5, (0.3, 0.625, 0.4), 0.2])
def test_another_spacing_from_the_same_corner_is_resampling(spacing, direction):
    source = random((0.4, 0.5, 0.6), direction)
    expected = source.resample(spacing)
    found = source.on(expected)
    np.testing.assert_array_equal(found.labels, expected.labels)
    assert (found.labels.dtype, found.names) == (np.uint16, {3: "x"})
    assert found.notes == ("labels are the nearest of random on the voxels of random",)


def test_turned_voxels_are_found_by_their_place():
    """Each voxel's label equals that at its centre, looked up in patient coordinates."""
    source = random((0.4, 0.5, 0.6), TURN)
    other = np.array([[0.0, 1, 0], [0, 0, -1], [1, 0, 0]])
    place = {"spacing": np.array((0.45, 0.35, 0.3)), "origin": source.origin + (0.3, -0.2, 0.1)}
    grid = grid_of(source, direction=other, shape=(6, 7, 8), **place)
    found, known = source.on(grid).labels, 0
    for k, j, i in np.ndindex(6, 7, 8):
        point = grid.origin + grid.direction @ (np.array((i, j, k)) * grid.spacing)
        x, y, z = np.rint(source.direction.T @ (point - source.origin) / source.spacing).astype(int)
        inside = 0 <= x < 11 and 0 <= y < 10 and 0 <= z < 9
        assert found[k, j, i] == (source.labels[z, y, x] if inside else 0)
        known += inside
    assert 0 < known < found.size
    np.testing.assert_allclose(grid.corners()[[0, -1]], [grid.origin, point])


def test_the_same_grid_and_one_elsewhere():
    turned, straight = random((0.4, 0.5, 0.6), TURN), random((0.4, 0.5, 0.6))
    np.testing.assert_array_equal(turned.on(grid_of(turned)).labels, turned.labels)
    half = straight.on(grid_of(straight, origin=(4, -5, 9.0)))
    assert (
        half.notes[-1] == "labels are the nearest of random on the voxels of grid, of which they cover 44.4 %"
    )
    np.testing.assert_array_equal(half.labels[:4], straight.labels[5:])
    assert not half.labels[4:].any()
    corner = straight.on(grid_of(straight, origin=(8, -0.5, 10.8)))
    assert corner.notes[-1].endswith("of which they cover less than 1 %")
    assert np.count_nonzero(corner.labels) <= 1


def test_finer_labels_of_a_volume(tmp_path):
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    grey = volume()
    own = LabelVolume(labels(), grey.spacing, grey.origin, grey.direction, "own", {1: "Bone"})
    finer = own.resample(0.125)
    refused(
        (lambda: anatomy_bone(grey, finer, TABLE, mapping=MAP),
         r"must have the same geometry: .*; labels\.on\(volume\) \(--onto\) takes the nearest label"),
    )  # fmt: skip
    expected = anatomy_bone(grey, own, TABLE, mapping=MAP)
    assert anatomy_bone(grey, finer.on(grey), TABLE, mapping=MAP).digest() == expected.digest()
    burrlab.write_volume(tmp_path / "ct.nrrd", grey)
    burrlab.write_volume(tmp_path / "finer.nrrd", finer)
    recipe = LabelledRecipe(
        str(tmp_path / "finer.nrrd"), TABLE, VolumeRecipe(str(tmp_path / "ct.nrrd"), MAP), onto=True
    )
    assert recipe.bone().digest() == expected.digest()
    assert any("labels are the nearest of" in note for note in recipe.notes())
    assert LabelledRecipe.of(recipe.plain()) == recipe
    assert make_bone(recipe.plain()).digest() == expected.digest()
