"""Tissues: default table, files, bone from grey values and labels; numbers and sums as parts of a bone's state."""

import copy
import pickle
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from label_scenes import anatomy_bone
from session_scenes import refused
from tick_scenes import assert_same_sums

from burrlab import (
    Burr,
    BurrContact,
    LabelVolume,
    Material,
    OccupancyMap,
    Tissue,
    Tissues,
    Volume,
    VoxelBone,
    _core,
    materials,
)
from burrlab.anatomy import LabelledRecipe, Watch, labelled_bone
from burrlab.bone.snapshot import tissues_from_json, tissues_to_json
from burrlab.bone.tissues import (
    KNOWN,
    VOLUMETRIC_DRILLING,
    default_tissues,
    known_tissue,
    label_counts,
    plain_name,
    read_tissues,
    tissues_text,
    write_tissues,
)

BONE = materials["bone"]
GREY = OccupancyMap.two_point(100, 200)
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def label_volume(labels: np.ndarray, names: dict[int, str] | None = None, **changes: object) -> LabelVolume:
    place = {"spacing": (0.2, 0.3, 0.4), "origin": (5, 6, 7), "direction": TURN, "path": "seg.nrrd"}
    return LabelVolume(labels, names=names or {}, **(place | changes))  # type: ignore[arg-type]


def grey_volume(values: np.ndarray) -> Volume:
    return Volume(values, (0.2, 0.3, 0.4), (5, 6, 7), TURN, "ct.nrrd")


def some() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    return random.integers(0, 256, (10, 11, 12)), random.integers(0, 3, (10, 11, 12))


def test_names_are_known_in_any_spelling() -> None:
    assert plain_name("Sinus_+_Dura") == plain_name("Sinus_and_Dura") == "sinus dura"
    for name in ("Facial_Nerve", "right facial nerve", "FACIAL-NERVE", "facial"):
        assert known_tissue(name).name == "facial nerve"
    assert known_tissue("spleen") is None
    texts = [plain_name(text) for known in KNOWN for text in (known.name, *known.synonyms)]
    assert len(texts) == len(set(texts))
    assert len(VOLUMETRIC_DRILLING) == len(set(VOLUMETRIC_DRILLING.values())) == 16
    table = default_tissues({1: "Left_Facial_Nerve", 2: "Right_Facial_Nerve"})
    assert [t.name for t in table] == ["facial nerve", "Right_Facial_Nerve"]


def test_only_bone_is_not_assumed_and_all_have_its_values() -> None:
    table = default_tissues({i: name for i, name in enumerate(VOLUMETRIC_DRILLING, 1)})
    assert [t.name for t in table if not t.assumed] == ["bone"]
    assert {(t.c_e, t.alpha) for t in table} == {(BONE.c_e, BONE.alpha)}
    canals = ["internal auditory canal", "temporomandibular joint", "external auditory canal"]
    assert [t.name for t in table if not t.critical] == ["bone", *canals]
    assert default_tissues(["vestibulocochlear nerve"])[0].critical
    before = Tissue("EAC", label=1, c_e=2.0, alpha=0.1, critical=True)  # from an earlier version
    assert tissues_from_json(tissues_to_json(Tissues([before], BONE)))[0].critical
    assert [t.name for t in table if t.bleeds] == ["internal carotid artery", "sinus and dura"]
    assert table[9].colour == (244, 214, 49)
    own = Material("own", c_e=3.0, alpha=0.2, shape="linear")
    assert {(t.c_e, t.alpha) for t in default_tissues(["bone", "dura"], material=own)} == {(3.0, 0.2)}


def test_cortex_and_mastoid_are_bone_wherever_they_are_named(tmp_path: Path) -> None:
    names = ["air", "Cortical_Bone", "mastoid bone", "dura"]
    (tmp_path / "t.csv").write_text("label,name\n" + "".join(f"{i},{name}\n" for i, name in enumerate(names)))
    for table in (default_tissues(names), read_tissues(tmp_path / "t.csv")):
        assert [t.assumed for t in table] == [True, False, False, True]


def test_a_label_volume_gives_names_and_colours() -> None:
    labels = np.zeros((2, 3, 4), np.uint8)
    labels[0] = 5
    table = default_tissues(label_volume(labels, {5: "Bone", 7: "Dura", 9: "spleen"}, colours={5: (1, 2, 3)}))
    assert [(t.label, t.name, t.colour) for t in table] == [
        (0, "unlabelled", (128, 128, 128)), (5, "bone", (1, 2, 3)), (7, "dura", (120, 200, 220)),
    ]  # fmt: skip


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int32])
def test_counts_of_labels(kind: type) -> None:
    far = 70_000 if kind is np.int32 else 201
    labels = np.array([[[0, 3]], [[3, far]], [[far, 200]]], kind)
    assert list(label_counts(labels, "l").items()) == [(0, 1), (3, 2), (200, 1), (far, 2)]


def test_a_file_gives_the_table_back(tmp_path: Path) -> None:
    own = Material(
        "own, with a comma", c_e=3.0, alpha=0.2, shape="quartic", source='a "source"', rate_exponent=0.5
    )
    rows = [
        Tissue("a, b", label=3, c_e=1.5, alpha=0.1, colour=(1, 2, 255), bleeds=True),
        Tissue("bone", label=1, c_e=3.0, alpha=0.2, assumed=False),
        Tissue("c", label=0, c_e=3.0, alpha=0.2, critical=True),
        Tissue("d", label=70000, c_e=3.0, alpha=0.3, assumed=False),
    ]
    table = Tissues(rows, own)
    write_tissues(tmp_path / "t.csv", table)
    assert read_tissues(tmp_path / "t.csv") == table
    assert "\n0,c,#e6dcbe,,,yes,no,yes\n" in (tmp_path / "t.csv").read_text()


def test_what_is_left_out_comes_from_the_name_and_the_bone(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(
        "label, name, c_e_N_per_mm2\n1,bone,2.0\n\n2,Facial_Nerve,\n# note\n3,spleen,1\n"
    )
    bone, nerve, spleen = read_tissues(tmp_path / "t.csv")
    assert (bone.c_e, bone.alpha, bone.assumed) == (2.0, BONE.alpha, True)
    assert (nerve.c_e, nerve.critical, nerve.colour, nerve.assumed) == (BONE.c_e, True, (244, 214, 49), True)
    assert (spleen.c_e, spleen.critical, spleen.bleeds) == (1.0, False, False)
    assert read_tissues(tmp_path / "t.csv", material=Material("other", c_e=9.0, alpha=0.5))[1].c_e == 9.0
    (tmp_path / "u.csv").write_text("label,name\n1,Bone\n2,Facial_Nerve\n")
    assert [tissue.assumed for tissue in read_tissues(tmp_path / "u.csv")] == [False, True]


HEAD = "label,name,colour,c_e_N_per_mm2,alpha_per_ms,critical,bleeds,assumed\n"


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (HEAD, "there is no row below the column names"),
        ("label,nome\n1,a\n", "t.csv: 2 faults: line 1: unknown column 'nome'; known are label, .*; line 1: column name is missing"),
        ("label,name\nx,a\n1,b\n1,c\n", "t.csv: 2 faults: line 2, column label: .*; line 4, column label: '1' is in line 3"),
        ("label,name\n1,a\n1,b\n", "line 3, column label: '1' is in line 2 already"),
        ("label,name\n1,a\n2,a\n", "line 3, column name: 'a' is in line 2 already"),
        ("label,name\n-1,a\n", "line 2, column label: must be a whole number from 0, got '-1'"),
        ("label,name\n1.0,a\n", "line 2, column label: must be a whole number from 0, got '1.0'"),
        ("label,name\n99999999999,a\n", "line 2, column label: must be a whole number from 0"),
        ("label,name\n1,\n", "line 2, column name: every row needs a name"),
        (HEAD + "1,,,,,,,\n2,structure 2,,,,,,\n3,CN7 (name?),,,,,,\n4,bone,,,,,,\n",
         r"t.csv, line 2, line 3 \('structure 2'\), line 4 \('CN7 \(name\?\)'\), column name: every row needs a name"),
        (HEAD + "1,a,red,,,,,\n", "line 2, column colour: must be #rrggbb, got 'red'"),
        (HEAD + "1,a,,x,,,,\n", "line 2, column c_e_N_per_mm2: 'x' is not a number"),
        (HEAD + "1,a,,0,,,,\n", "line 2, column c_e_N_per_mm2: must be from 1/4096 to 1000, got '0'"),
        (HEAD + "1,a,,nan,,,,\n", "line 2, column c_e_N_per_mm2: must be from 1/4096 to 1000, got 'nan'"),
        (HEAD + "1,a,,,-1,,,\n", "line 2, column alpha_per_ms: must be zero or positive, got '-1'"),
        (HEAD + "1,a,,,inf,,,\n", "line 2, column alpha_per_ms: must be zero or positive, got 'inf'"),
        (HEAD + "1,a,,,,maybe,,\n", "line 2, column critical: must be yes or no, got 'maybe'"),
        (HEAD + "1,a,,,,,,no\n", "line 2, column assumed: must be yes where c_e or alpha is empty"),
        ("# material: {}\nlabel,name\n1,a\n", "t.csv: the material in the comments is none"),
        (HEAD + "".join(f"{i},t{i},,,,,,\n" for i in range(65)),
         "t.csv: number of tissues must be 1 to 64, got 65"),
    ],
)  # fmt: skip
def test_bad_table_files(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    refused((lambda: read_tissues(tmp_path / "t.csv"), match))


def test_grey_values_and_labels_make_a_bone() -> None:
    grey, labels = some()
    table = default_tissues({1: "bone", 2: "facial nerve"})
    made = labelled_bone(grey_volume(grey), label_volume(labels), table, mapping=GREY)
    bone, levels = made.bone, GREY.levels(grey)
    assert bone.digest() != grey_volume(grey).to_bone(GREY).digest()
    np.testing.assert_array_equal(bone.density, levels)
    assert [t.name for t in bone.tissues] == ["bone", "facial nerve", "unlabelled"]
    np.testing.assert_array_equal(bone.tissue_numbers, np.array([2, 0, 1], np.uint8)[labels])
    np.testing.assert_allclose(bone.spacing, (0.2, 0.3, 0.4))
    np.testing.assert_allclose(bone.origin, TURN.T @ (5, 6, 7))
    held = np.count_nonzero((labels == 0) & (levels >= 128))
    assert f"{held} voxels of label 0 hold bone: unlabelled, with the bone's c_e and alpha" in made.notes
    bare = 2 * np.count_nonzero(levels[labels == 2] >= 128) < np.count_nonzero(labels == 2)
    told = ["facial nerve: " in note and "what is empty cannot be injured" in note for note in made.notes]
    assert any(told) == bare


def test_a_structure_can_be_filled() -> None:
    labels = np.zeros((4, 4, 4), int)
    labels[1] = 2
    given = (
        replace(grey_volume(np.zeros((4, 4, 4))), notes=("of the volume",)),
        replace(label_volume(labels), notes=("of the labels",)),
        default_tissues({1: "bone", 2: "facial nerve"}),
    )
    bare = "facial nerve: 0 % of its voxels are half full or more; what is empty cannot be injured (fill=, --fill)"
    assert bare in labelled_bone(*given, mapping=GREY).notes
    made = labelled_bone(*given, mapping=GREY, fill={"facial nerve": 0.5})
    np.testing.assert_array_equal(made.bone.density[1], 128)
    assert made.bone.mass_of("facial nerve") > 0
    assert made.notes == (
        "of the volume",
        "of the labels",
        "facial nerve: occupancy at least 0.5, as asked",
    )


def test_labels_alone() -> None:
    _, labels = some()
    alone = labelled_bone(None, label_volume(labels), THREE)
    np.testing.assert_array_equal(alone.bone.density, np.where(labels == 0, 0, 255))
    assert "occupancy from labels alone" in alone.notes[0]
    moved = anatomy_bone(None, label_volume(labels), default_tissues({1: "air", 0: "bone", 2: "dura"}))
    np.testing.assert_array_equal(moved.density, np.where(labels == 2, 255, 0))


def test_the_ear_canal_is_air_unless_told() -> None:
    _, labels = some()
    table = default_tissues(["air", "bone", "Ear_Canal"])
    for options, solid in (
        ({}, labels == 1),
        ({"fill": {"external auditory canal": 1.0}}, labels != 0),
        ({"empty": ["air"]}, labels != 0),
    ):
        bone = anatomy_bone(None, label_volume(labels), table, **options)
        np.testing.assert_array_equal(bone.density, np.where(solid, 255, 0))
    plain = LabelledRecipe("seg.nrrd", table).plain()
    assert plain.pop("empty") == ["air", "external auditory canal"]
    assert LabelledRecipe.of(plain).empty == ("air",)  # as in earlier versions
    assert LabelledRecipe.of(plain).plain() == plain


def test_smoothed_labels_keep_volumes_and_critical_structures() -> None:
    z, y, x = np.ogrid[:40, :50, :60]
    labels = (0.5 * z + 0.2 * y + 0.1 * x < 18).astype(np.uint8)
    labels[(labels > 0) & ((z - 24) ** 2 + (y - 25) ** 2 < 36)] = 2
    labels[:, :, 40:] = 0
    labels[:, :, 48:51] = 3  # a wall of three voxels beside a bare nerve
    table = default_tissues({0: "air", 1: "cortex", 2: "facial nerve", 3: "mastoid"})
    volume = LabelVolume(labels, (0.1, 0.1, 0.15), (0, 0, 0), np.eye(3), "made")
    plain, made = (labelled_bone(None, volume, table, smooth=width) for width in (None, 0.2))
    assert "scatter: 11 to 17 % at R/voxel = 10, 6 to 15 % at R/voxel = 20" in plain.notes[0]
    assert "smoothed by 0.2 mm: the volume changes by" in made.notes[0]
    nerve = labels == 2
    np.testing.assert_array_equal(made.bone.tissue_numbers == 2, nerve)
    assert (made.bone.density[nerve] == 255).all()
    points = np.random.default_rng(1).uniform(0, 5, (50, 3))
    before, after = (Watch(bone).distance(points, "facial nerve") for bone in (plain.bone, made.bone))
    np.testing.assert_array_equal(after, before)
    for name in ("cortex", "mastoid"):
        assert made.bone.mass_of(name) == pytest.approx(plain.bone.mass_of(name), rel=2e-3)
    assert made.bone.mass == pytest.approx(plain.bone.mass, rel=2e-3)
    assert made.bone.density[20, 25, 49] == 139  # 255 erf(t/(2 sqrt(2) width)), t = 0.3 mm
    assert not made.bone.density[(labels == 0) & (made.bone.tissue_numbers == 0)].any()
    block = LabelVolume(
        np.repeat([1, 1, 1, 0, 0, 0], 6 * 6).reshape(6, 6, 6), 0.1, (0, 0, 0), np.eye(3), "made"
    )
    parts = labelled_bone(None, block, default_tissues(["air", "bone"]), smooth=0.1).bone.density[:, 3, 3]
    assert parts.tolist() == [253, 238, 176, 79, 17, 2]  # weights 2, 15, 62, 98, 62, 15, 2 of 256


def test_smoothing_needs_little_memory_and_keeps_its_bits() -> None:
    z, y, x = np.ogrid[:128, :128, :96]
    labels = ((z + 20 * np.sin(y / 9.0) + 15 * np.cos(x / 7.0)) // 32 % 4).astype(np.uint8)
    table = default_tissues({0: "air", 1: "bone", 2: "facial nerve", 3: "mastoid"})
    volume = LabelVolume(labels, (0.1, 0.12, 0.15), (0, 0, 0), np.eye(3), "made")
    tracemalloc.start()
    try:
        bone = labelled_bone(None, volume, table, smooth=0.2).bone
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert bone.digest() == "b21bd0663c96effed6047ab8757f50ca"
    assert peak < 6 * labels.size  # beside the bone itself [bytes]


def test_a_structure_in_far_pieces_or_much_too_large_gets_a_note() -> None:
    table = default_tissues({1: "bone", 2: "facial nerve", 3: "dura", 4: "chorda tympani"})
    labels = np.ones((100, 80, 80), np.uint8)
    labels[10:90, 20:28, 20:28] = 2  # 2 mm thick, 20 mm long
    labels[:, 60:, :40], labels[:, :, 70:] = 3, 4
    labels[5, 75, 75] = 3  # beyond the chorda
    assert labelled_bone(None, LabelVolume(labels, 0.25, (0, 0, 0), np.eye(3), "made"), table).notes[1:] == (
        "chorda tympani: 1250 mm^3, 12 times a nerve of 2 x 32 mm; is another structure in it?",
        "dura: in 2 pieces, over 5 mm apart",
    )


def test_a_box_of_labels_is_placed_on_the_volume() -> None:
    grey, labels = some()
    box = label_volume(labels).crop_voxels((2, 3, 4), (9, 10, 11))
    expected = np.zeros_like(labels)
    expected[2:9, 3:10, 4:11] = labels[2:9, 3:10, 4:11]
    bone = anatomy_bone(grey_volume(grey), box, THREE, mapping=GREY)
    np.testing.assert_array_equal(bone.tissue_numbers, expected)


def test_another_spacing() -> None:
    (grey, labels), half = some(), {"spacing": (0.1, 0.15, 0.2)}
    bone = anatomy_bone(grey_volume(grey), label_volume(labels), THREE, mapping=GREY, **half)
    plain = grey_volume(grey).to_bone(GREY, **half)
    np.testing.assert_array_equal(bone.tissue_numbers, labels.repeat(2, 0).repeat(2, 1).repeat(2, 2))
    assert bone.digest() != plain.digest()
    np.testing.assert_array_equal(bone.density, plain.density)
    fine = anatomy_bone(None, label_volume(labels), THREE, **half)
    np.testing.assert_array_equal(fine.density, np.where(bone.tissue_numbers == 0, 0, 255))
    np.testing.assert_allclose(fine.origin, bone.origin, rtol=1e-12)


# --- Tissues as a part of a bone's state ---------------------------------------------------------------------


TABLE = Tissues(
    [Tissue(f"tissue {i}", label=10 * i, c_e=1.0 + i, alpha=0.1 * i) for i in range(3)],
    BONE,
)


def tissue_bone() -> tuple[VoxelBone, np.ndarray]:
    """Bone with random tissues in one half, one tissue in the other: mixed and uniform bricks."""
    random = np.random.default_rng(4)
    numbers = random.integers(0, 3, (19, 21, 18)).astype(np.uint8)
    numbers[:, :, 8:] = 2
    bone = VoxelBone(random.integers(0, 256, numbers.shape).astype(np.uint8), 0.2)
    bone.set_tissues(TABLE, numbers)
    return bone, numbers


def test_numbers_come_back_and_sums_follow_every_change() -> None:
    bone, numbers = tissue_bone()
    np.testing.assert_array_equal(bone.tissue_numbers, numbers)
    for change in (
        lambda: None,
        lambda: bone.write(np.full((5, 9, 11), 77, np.uint8), (2, 3, 4)),
        lambda: bone.restore((bone.density // 2).astype(np.uint8)),
    ):
        change()
        assert_same_sums(bone, numbers)
    assert bone.removed_of("tissue 1") > 0
    bone.reset()
    assert_same_sums(bone, numbers)


def test_copies_and_pickles_carry_tissues() -> None:
    bone, numbers = tissue_bone()
    bone.restore((bone.density // 3).astype(np.uint8))
    for again in (bone.copy(), copy.deepcopy(bone), pickle.loads(pickle.dumps(bone))):
        assert (again.digest(), again.tissues) == (bone.digest(), bone.tissues)
        assert_same_sums(again, numbers)


def test_digest_tells_numbers_and_table_apart() -> None:
    bone, numbers = tissue_bone()
    plain, other, rows = VoxelBone(bone.pristine, 0.2), numbers.copy(), list(TABLE)
    other[0, 0, 0] = (other[0, 0, 0] + 1) % 3
    critical = Tissue("tissue 2", label=20, c_e=3.0, alpha=0.2, critical=True)
    digests = {plain.digest(), bone.digest()}
    for tissues, given in (
        (TABLE, other),
        (Tissues([*rows[:2], critical], BONE), numbers),
        (Tissues(rows, Material("b", c_e=2.145, alpha=0.087, shape="linear")), numbers),
        (Tissues(rows, Material("b", c_e=2.145, alpha=0.087, force_exponent=2.0)), numbers),
        (Tissues(rows, Material("b", c_e=2.145, alpha=0.087, rate_exponent=1.0)), numbers),
    ):
        plain.set_tissues(tissues, given)
        digests.add(plain.digest())
    assert len(digests) == 7


def test_a_packed_bone_is_the_same() -> None:
    bone, given = tissue_bone()
    faint = bone.read((0, 0, 0), bone.shape).copy()
    faint[:8, :, 8:], faint[8:, :, 8:] = 7, 0  # uniform bricks
    bone.write(faint)
    for one in (bone, VoxelBone(faint, (0.1, 0.2, 0.3), (1, 2, 3))):
        levels, numbers = _core.pack_bone(one)
        again = _core.unpack_bone(one.shape, one.spacing, one.origin, levels, one.tissues, numbers)
        center = np.array(one.origin) + 0.5 * np.array(one.spacing) * one.shape[::-1]
        for burred in (one, again):
            assert burred.removed == 0
            BurrContact(burred, Burr(1.2), BONE, seed=1).step(center, dt=1.0)
        if one.tissues is not None:
            assert_same_sums(again, given)
        assert (again.digest(), again.mass, again.removed > 0) == (one.digest(), one.mass, True)
    levels, numbers = _core.pack_bone(bone)
    strange = numbers.copy()
    strange[-1] = 3
    unpacked = partial(_core.unpack_bone, bone.shape, bone.spacing, bone.origin, levels, bone.tissues)
    refused(
        (lambda: unpacked(numbers[:-1]), "packed bricks must fill the shape"),
        (lambda: unpacked(numbers[:3]), "packed bricks must fill the shape"),
        (lambda: unpacked(strange), "every tissue number must be below 3"),
    )


# --- Refusals -----------------------------------------------------------------------------------------------


def row(name: str = "a", label: int = 0, c_e: float = 1, alpha: float = 0) -> Tissue:
    return Tissue(name, label=label, c_e=c_e, alpha=alpha)


def numbered(numbers: np.ndarray) -> VoxelBone:
    bone = VoxelBone.block((1, 1, 1), 0.1)
    bone.set_tissues(TABLE, numbers)
    return bone


FIVES = np.repeat(np.array([5, 0], np.uint8), 12).reshape(2, 3, 4)
THREE = default_tissues(["air", "bone", "dura"])


def made(
    source: object = None,
    table: Tissues = THREE,
    shown: slice = slice(None),
    place: object = None,
    **options: object,
) -> object:
    """A bone from the values of `some`, with a wrong source, table or place."""
    grey, labels = some()
    if isinstance(source, str):
        source = {"grey": grey_volume(grey), "labels": labels}[source]
    return labelled_bone(source, label_volume(labels[shown], **(place or {})), table, **options)  # type: ignore[arg-type, dict-item]


def rows_of(names: list[str]) -> Tissues:
    return Tissues([Tissue(name, label=i, c_e=1, alpha=0) for i, name in enumerate(names, 1)], BONE)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Tissues([], BONE), "number of tissues must be 1 to 64, got 0"),
        (lambda: Tissues([row("")], BONE), "name of a tissue must not be empty"),
        (lambda: Tissues([row(), row(label=1)], BONE), "names of tissues must differ, got 'a' twice"),
        (lambda: Tissues([row(), row("b")], BONE), "labels of tissues must be different, got 0"),
        (lambda: Tissues([row(label=-1)], BONE), "label of 'a' must be zero or positive, got -1"),
        (lambda: Tissues([row(c_e=0)], BONE), "c_e of 'a' must be from 1/4096 to 1000"),
        (lambda: Tissues([row(c_e=float("nan"))], BONE), "c_e of 'a' must be from"),
        (lambda: Tissues([row(alpha=-1)], BONE), "alpha of 'a' must be zero or positive"),
        (lambda: Tissue("a", label=0, c_e=1, alpha=0, colour=(256, 0, 0)),
         "every part of a colour must be 0 to 255, got 256"),
        (lambda: numbered(np.full((10, 10, 10), 3, np.uint8)), "every tissue number must be below 3, got 3"),
        (lambda: numbered(np.zeros((2, 2, 2), np.uint8)), "must be uint8 and have the shape of the bone"),
        (lambda: numbered(np.zeros((10, 10, 10), np.int64)), "must be uint8 and have the shape of the bone"),
        (lambda: VoxelBone.block((1, 1, 1), 0.1).removed_of(0), "bone must have tissues"),
        (lambda: numbered(np.zeros((10, 10, 10), np.uint8)).removed_of("spleen"),
         "tissue must be a name or number of the bone's table"),
        (lambda: TABLE.number("spleen"),
         "tissue must be one of tissue 0, tissue 1, tissue 2, got 'spleen'"),
        (lambda: default_tissues(label_volume(np.arange(70).reshape(7, 5, 2))),
         r"at most 64 tissues, and there are 70 labels \(0, 1, 2, 3, 4"),
        (lambda: default_tissues("bone"), "got the text 'bone'"),
        (lambda: default_tissues(label_volume(FIVES, {5: "spleen"})), r"does not know label 5 \('spleen', 12 voxels\); it knows air, .*"
         r"read_tissues, `burrlab tissues FILE --template table.csv`\)"),
        (lambda: default_tissues(label_volume(FIVES)), r"seg.nrrd: the labels 5 \(12 voxels\) have no names in the file"),
        (lambda: label_counts(np.array([[-1, 0]]), "l"), "l: labels must be zero or positive, got -1"),
        (lambda: tissues_text(rows_of(["a\nb"])), r"name of a tissue must be one line .*got 'a\\nb'"),
        (lambda: made("grey", place={"spacing": (0.2, 0.3, 0.5)}, mapping=GREY),
         "must have the same geometry: spacing"),
        (lambda: made("grey", place={"origin": (5, 6, 7.1)}, mapping=GREY),
         "must have the same geometry: origin"),
        (lambda: made("grey", place={"direction": np.eye(3)}, mapping=GREY),
         "must have the same geometry: directions"),
        (lambda: made("grey", shown=slice(9), place={"origin": (5, 6, 5)}, mapping=GREY),
         "12 x 11 x 10 voxels against 12 x 11 x 9"),
        (lambda: made("grey"), r"mapping must be given for the grey values of ct.nrrd"),
        (lambda: made(mapping=GREY), "mapping must be given with grey values only"),
        (lambda: made("labels"), r"source must be a Volume, such as .*, got array"),
        (lambda: made("grey", mapping=GREY, smooth=0.2),
         "smooth goes with labels alone, got 0.2 beside"),
        (lambda: made(smooth=0.05),
         "smooth must be 1 to 10 times the finest side of a voxel, 0.2 to 2 mm, got 0.05"),
        (lambda: made(table=default_tissues(["air", "bone"])),
         rf"labels that are not in the table: 2 \({np.count_nonzero(some()[1] == 2)} voxels\); the table has 0 air, 1 bone"),
        (lambda: made("grey", mapping=GREY, fill={"spleen": 0.5}), r"fill must be of tissues of the table \(air, bone, dura\), got 'spleen'"),
        (lambda: made("grey", mapping=GREY, fill={"dura": 2}),
         "fill of 'dura' must be an occupancy from 0 to 1, got 2"),
        (lambda: made(table=rows_of([f"t{i}" for i in range(64)])), "the table must have a row for label 0"),
        (lambda: made(table=rows_of(["unlabelled", "b"])),
         "the table must have 'unlabelled' for label 0 only"),
    ],
)  # fmt: skip
def test_refusals(make: Callable[[], object], match: str) -> None:
    refused((make, match, (ValueError, TypeError)))
