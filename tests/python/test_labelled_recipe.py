"""Recipes of labelled bones: made from files, kept as JSON, made again elsewhere."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from drilled_scenes import stack
from label_scenes import MAP, SPACING, TABLE, anatomy_bone, labels, volume, write_files
from session_scenes import ended, refused, session_of
from test_stack import wrapped

from burrlab import Burr, ScriptedDevice, materials, read_labels, read_volume
from burrlab.anatomy import Watch, default_tissues
from burrlab.bone.kept import save_drilled
from burrlab.bone.recipe import WORTH_SMOOTHED, LabelledRecipe, VolumeRecipe, make_bone

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pytest.importorskip("yaml", reason="extra `medical` is not installed")

VOLUME = volume()


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_files(tmp_path)
    return tmp_path


def test_a_recipe_comes_back_and_makes_the_same_bone(files: Path) -> None:
    low, high = (tuple(VOLUME.origin + VOLUME.patient_point(p)) for p in ((-1, -1, -1.0), (5, 5, 6.0)))
    colours = default_tissues({1: "bone", 10: "facial nerve"})
    filled = LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP), {"facial nerve": 0.5})
    cropped = LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP, crop=(low, high)))
    finer = LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP, voxel=0.2))
    alone = LabelledRecipe("a.seg.nrrd", TABLE, voxel=(0.2, 0.2, 0.2), smooth=0.5)
    slices = LabelledRecipe("slices", colours, spacing=SPACING, unknown="nearest", transpose=True)
    described = LabelledRecipe("v.yaml", colours, unit=500.0)
    for recipe in (filled, cropped, finer, alone, slices, described):
        plain, like, bone = json.loads(json.dumps(recipe.plain())), recipe.like(), recipe.bone()
        assert (LabelledRecipe.of(plain), make_bone(plain).digest()) == (recipe, bone.digest())
        assert (like.shape, bone.removed) == (bone.shape, 0)
        np.testing.assert_allclose(like.bone_point(like.origin), bone.origin, atol=1e-9)
    whole = anatomy_bone(read_volume("ct.nrrd"), read_labels("labels.nii.gz"), TABLE, mapping=MAP)
    least = np.where(labels() == 4, 128, 0)
    np.testing.assert_array_equal(filled.bone().density, np.maximum(whole.density, least))
    part = cropped.bone()
    assert np.prod(part.shape) < np.prod(whole.shape)
    start = np.rint((np.array(part.origin) - whole.origin) / SPACING).astype(int)
    cut = tuple(slice(a, a + n) for a, n in zip(start[::-1], part.shape, strict=True))
    np.testing.assert_array_equal(part.density, whole.density[cut])
    np.testing.assert_array_equal(part.tissue_numbers, whole.tissue_numbers[cut])
    assert described.bone().spacing == (0.125, 0.125, 0.125)
    np.testing.assert_array_equal(slices.bone().tissue_numbers > 0, labels() != 1)


@pytest.mark.parametrize(
    ("source", "voxel", "bone"),
    [("a.seg.nrrd", None, "Bone"), ("a.seg.nrrd", 0.2, "Bone"), ("labels.nii.gz", None, "bone"), ("v.yaml", None, "bone")],
)  # fmt: skip
def test_a_half_drilled_segmentation_keeps_names_and_colours(
    files: Path, source: str, voxel: float | None, bone: str
) -> None:
    recipe = LabelledRecipe(source, TABLE, voxel=voxel and (voxel,) * 3)
    save_drilled("kept.seg.nrrd", recipe.bone(), recipe.like())
    kept, nerve = read_labels("kept.seg.nrrd"), "Facial_Nerve" if bone == "Bone" else "facial nerve"
    assert (kept.names, recipe.ranking is None) == ({1: bone, 4: nerve}, source != "v.yaml")
    assert kept.colours == (recipe.like().colours or {1: (255, 249, 219), 4: (244, 214, 49)})
    if bone == "Bone" and voxel is None:
        np.testing.assert_array_equal(kept.labels, recipe.like().labels)


def test_a_session_touches_what_is_there(tmp_path: Path) -> None:
    planes = np.zeros((24, 20, 20, 4), np.uint8)
    planes[:18] = wrapped("Bone")
    planes[14:16, 9:11] = wrapped("Bone", "Chorda_Tympani")
    planes[:3] = wrapped("Sinus_+_Dura")
    folder = stack(tmp_path / "s", planes, name="plane{:03d}.png")
    table = default_tissues({1: "bone", 11: "chorda tympani", 13: "sinus and dura"})
    plain = LabelledRecipe(str(folder), table, spacing=SPACING, unknown="nearest", transpose=False).plain()
    before = {key: value for key, value in plain.items() if key != "ranking"}
    # The dura lies 3 mm below; without a ranking, sums were read as dura.
    for kept, touched in ((plain, {"chorda tympani"}), (before, {"sinus and dura"})):
        recipe = LabelledRecipe.of(json.loads(json.dumps(kept)))
        assert recipe.plain() == kept
        bone, device = recipe.bone(), ScriptedDevice([0, 0.5], [(2.5, 2.4, 6), (2.5, 2.4, 4.6)])
        options = {"seed": 1, "duration": 0.5, "wall_clock": False, "watch": Watch(bone)}
        session = ended(session_of(bone, (Burr(1.0), materials["bone"]), device, **options))
        assert {e.structure for e in session.anatomy().events if e.kind == "touch"} == touched


def of_grey(**options: object) -> LabelledRecipe:
    return LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: of_grey(voxel=(0.1, 0.1, 0.1)), "crop and voxel must be those of the grey volume"),
        (lambda: of_grey(smooth=0.3), "smooth goes with labels alone"),
        (lambda: LabelledRecipe("x.nrrd", TABLE, onto=True), "onto goes with a grey volume"),
        (lambda: LabelledRecipe("a.seg.nrrd", TABLE).check_burr(Burr(1)), r"radius of the burr must be at least 4 voxels of 0\.4 mm, got 1 mm"),
        (lambda: of_grey().check_burr(Burr(0.9)), r"radius of the burr must be at least 4 voxels of 0\.25 mm"),
        (lambda: make_bone({"kind": "labelled volume", "labels": "x"}),
         "recipe must be that of block_recipe"),
        (lambda: make_bone({"kind": "labelled volume", "labels": "x", "tissues": "{}"}),
         "recipe must be that of block_recipe"),
        (lambda: make_bone({"kind": "labelled volume", "labels": 3, "tissues": "[]"}),
         "recipe must be that of block_recipe"),
        (lambda: make_bone({"kind": "drilled volume", "path": "x.nrrd"}),
         "recipe must be that of block_recipe"),
    ],
)  # fmt: skip
def test_wrong_recipes(files: Path, make: Callable[[], object], match: str) -> None:
    refused((make, match))


def test_a_recipe_of_files_that_lie_elsewhere(files: Path) -> None:
    recipe, there = of_grey(), files / "there"
    plain, digest = recipe.plain(), recipe.bone().digest()
    there.mkdir()
    for old, new in (("ct.nrrd", "other.nrrd"), ("labels.nii.gz", "labels.nii.gz")):
        (files / old).rename(there / new)
        assert make_bone(plain, volume="there/other.nrrd").digest() == digest
    refused((lambda: make_bone(plain), r"labels\.nii\.gz: no such file", FileNotFoundError))


KEPT = (
    lambda: VolumeRecipe("ct.nrrd", MAP, voxel=0.2),
    lambda: LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP), {"facial nerve": 0.5}),
    lambda: LabelledRecipe(
        "v.yaml", default_tissues({1: "bone", 10: "facial nerve"}), unit=500.0, smooth=0.6
    ),
)


@pytest.fixture
def cache(files: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache that keeps bones of any size, of files of any age."""
    monkeypatch.setenv("BURRLAB_CACHE", str(files / "cache"))
    for worth in ("WORTH", "WORTH_SMOOTHED"):
        monkeypatch.setattr(f"burrlab.bone.recipe.{worth}", 1)
    monkeypatch.setattr("burrlab.common.cache._SETTLED", -1.0)
    return files / "cache"


@pytest.mark.parametrize("recipe", KEPT)
def test_a_kept_bone_is_the_same(
    recipe: Callable[[], VolumeRecipe], cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def made() -> tuple[object, ...]:
        one = recipe()
        one.check_burr(Burr(3.0))
        corners = one.grid().corners()
        found = one.specimen(entry=[*corners.mean(axis=0)[:2], corners[:, 2].max() + 1], axis=(0, 0, -1))
        bone, masses = one.bone(), [found.bone.mass_of(i) for i in range(len(found.bone.tissues or ()))]
        return bone.digest(), found.bone.digest(), bone.mass, masses, found.made, one.notes(), one.plain()

    first = made()
    assert len(list(cache.iterdir())) == 1
    for reader in ("read_volume", "labels_of"):
        monkeypatch.setattr(f"burrlab.bone.recipe.{reader}", lambda *_: pytest.fail("a volume is read"))
    assert made() == first


def test_a_kept_bone_of_other_files_or_a_damaged_one_is_made_anew(cache: Path) -> None:
    recipe = KEPT[1]
    first, [kept] = recipe().bone().digest(), list(cache.iterdir())
    for damage in (lambda content: content[:-1], lambda content: content[:700] + b"x" + content[701:]):
        kept.write_bytes(damage(kept.read_bytes()))
        assert recipe().bone().digest() == first
    before, content = Path("ct.nrrd").stat(), Path("ct.nrrd").read_bytes()
    Path("ct.nrrd").write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    os.utime("ct.nrrd", ns=(before.st_atime_ns, before.st_mtime_ns))
    now = Path("ct.nrrd").stat()
    assert (now.st_size, now.st_mtime_ns, now.st_ino) == (before.st_size, before.st_mtime_ns, before.st_ino)
    refused((recipe().bone, "compressed data"))  # its checksum is wrong by now
    Path("ct.nrrd").unlink()
    Path("ct.nrrd").write_bytes(content)  # another file of the same content
    assert recipe()._kept is not None
    assert recipe().bone().digest() == first


def test_a_session_needs_no_cache(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.write_text("no folder")
    first = KEPT[0]().bone().digest()
    cache.unlink()
    monkeypatch.setattr("burrlab.common.cache.MOST", 1)  # there is no room
    assert KEPT[0]().bone().digest() == first
    assert list(cache.iterdir()) == []


def test_what_is_kept_is_closed_to_others(
    cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    first = KEPT[0]().bone().digest()
    assert (cache.stat().st_mode & 0o777, *(path.stat().st_mode & 0o777 for path in cache.iterdir())) == (
        0o700,
        0o600,
    )
    assert KEPT[0]()._kept is not None
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: os.stat(cache).st_uid + 1)
        assert KEPT[0]()._kept is None  # another user's
    for mode in (0o770, 0o755):
        cache.chmod(mode)
        assert (KEPT[0]()._kept, KEPT[0]().bone().digest()) == (None, first)
    assert [record.getMessage() for record in caplog.records] == [
        f"nothing is kept: {cache} must be your own folder, closed to others (chmod 700)"
    ]


def test_smoothed_labels_are_kept_from_a_smaller_size(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert WORTH_SMOOTHED == (1 << 22)
    monkeypatch.setattr("burrlab.bone.recipe.WORTH", 1 << 24)
    for smooth, kept in ((None, False), (0.8, True)):
        LabelledRecipe("a.seg.nrrd", TABLE, smooth=smooth).bone()
        assert (LabelledRecipe("a.seg.nrrd", TABLE, smooth=smooth)._kept is not None) == kept


def test_what_was_not_used_for_longest_goes_first(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for recipe in KEPT[:2]:
        recipe().bone()
        for path in cache.iterdir():
            os.utime(path, (path.stat().st_atime, path.stat().st_mtime - 100))
    assert KEPT[0]()._kept is not None  # it was used
    monkeypatch.setattr("burrlab.common.cache.MOST", sum(path.stat().st_size for path in cache.iterdir()))
    VolumeRecipe("ct.nrrd", MAP, voxel=0.5).bone()
    assert [recipe()._kept is not None for recipe in KEPT[:2]] == [True, False]
