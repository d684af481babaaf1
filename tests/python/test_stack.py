"""PNG stacks: order, axes, colours, descriptions, refusals."""

import os
import struct
import zlib
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drilled_scenes import stack as save
from PIL import Image
from session_scenes import refused

from burrlab import LabelVolume, OccupancyMap, Tissue, Tissues, materials
from burrlab.bone.recipe import LabelledRecipe, VolumeRecipe, labels_of
from burrlab.bone.slices import ROWS_ALONG_X, read_stack
from burrlab.bone.tissues import VOLUMETRIC_DRILLING, default_tissues

needs_yaml = pytest.mark.skipif(find_spec("yaml") is None, reason="extra `medical` is not installed")
SILENT = "PNG slices say no orientation: LPS assumed"
BONE, NERVE = VOLUMETRIC_DRILLING["Bone"], VOLUMETRIC_DRILLING["Facial_Nerve"]


def grey(shape: tuple[int, int, int] = (12, 4, 5), kind: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(3).integers(0, np.iinfo(kind).max, shape).astype(kind)


def coloured(shape: tuple[int, int, int] = (3, 4, 5)) -> np.ndarray:
    """Transparent slices, except bone in the first and a nerve at row 1, column 3 of the second."""
    planes = np.zeros((*shape, 4), np.uint8)
    planes[0] = (*BONE, 255)
    planes[1, 1, 3] = (*NERVE, 255)
    return planes


def adf(
    folder: Path, *, dimensions: str = "{x: 0.05, y: 0.04, z: 0.03}", extra: str = "", count: int = 512
) -> Path:
    path = folder / "volume.yaml"
    path.write_text(
        f"# a comment\nvolumes: [VOLUME v]\n\nVOLUME v:\n  name: v\n  dimensions: {dimensions}\n{extra}"
        f"  images:\n    path: slices/\n    prefix: plane00\n    format: png\n    count: {count}\n"
    )
    return path


def read_labels(place: Path, spacing: Any = 0.1, transpose: bool = False, **options: Any) -> LabelVolume:
    found = read_stack(place, spacing=spacing, transpose=transpose, **options)
    assert isinstance(found, LabelVolume)
    return found


def seen(labels: LabelVolume, *places: tuple[int, int, int]) -> list[int]:
    return [int(labels.labels[place]) for place in places]


@pytest.mark.parametrize(
    ("name", "kind"),
    [("plane00{}.png", np.uint8), ("s{:04d}.PNG", np.uint16), ("7_{}.png", np.uint8)],
)
def test_grey_slices_in_the_order_of_their_numbers(tmp_path: Path, kind: type, name: str) -> None:
    values = grey(kind=kind)
    volume = read_stack(save(tmp_path / "s", values, name=name), spacing=(0.1, 0.2, 0.3))
    assert volume.values.dtype == kind
    for part, wanted in {
        "values": values,
        "spacing": (0.1, 0.2, 0.3),
        "origin": 0,
        "direction": np.eye(3),
    }.items():
        np.testing.assert_array_equal(getattr(volume, part), wanted)


def test_axes_of_an_asymmetric_pattern(tmp_path: Path) -> None:
    folder = save(tmp_path / "s", coloured())
    labels = read_labels(folder)
    wanted = np.zeros((3, 4, 5))
    wanted[0], wanted[1, 1, 3] = 1, 10  # (z, y, x): slice, row, column
    np.testing.assert_array_equal(labels.labels, wanted)
    assert (labels.names[10], labels.colours[10], labels.notes) == ("Facial_Nerve", NERVE, (SILENT,))
    np.testing.assert_array_equal(
        read_labels(folder, transpose=True).labels, labels.labels.transpose(0, 2, 1)
    )


@pytest.mark.parametrize("mode", ["RGBA", "RGB", "P"])
def test_modes_of_colour_give_the_same_labels(tmp_path: Path, mode: str) -> None:
    planes = coloured()
    planes[..., :3][planes[..., 3] == 0] = 0  # black is empty too
    planes[..., 3] = 255
    for k, plane in enumerate(planes):
        image = Image.fromarray(plane).convert("RGB" if mode == "P" else mode)
        (image.quantize(8) if mode == "P" else image).save(tmp_path / f"p{k}.png")
    found = read_labels(tmp_path)
    assert (np.count_nonzero(found.labels), seen(found, (0, 0, 0), (1, 1, 3))) == (21, [1, 10])


def test_grey_written_as_colours_is_grey(tmp_path: Path) -> None:
    values = grey((3, 4, 5))
    planes = np.repeat(values[..., None], 4, axis=-1)
    planes[..., 3] = 255
    np.testing.assert_array_equal(read_stack(save(tmp_path / "s", planes), spacing=0.1).values, values)


def test_palettes_of_names_and_of_tissues(tmp_path: Path) -> None:
    folder = save(tmp_path / "s", coloured())
    named = read_labels(folder, palette={"nerve": NERVE, "bone": BONE})
    assert (seen(named, (1, 1, 3), (0, 0, 0)), named.names) == ([1, 2], {1: "nerve", 2: "bone"})
    rows = [
        Tissue(n, label=label, c_e=1, alpha=0, colour=c)
        for n, label, c in (("bone", 300, BONE), ("nerve", 7, NERVE))
    ]
    table = read_labels(folder, palette=Tissues(rows, materials["bone"]))
    assert (table.labels.dtype, seen(table, (1, 1, 3), (0, 0, 0), (2, 0, 0))) == (np.uint16, [7, 300, 0])


@pytest.mark.parametrize(
    "palette", [None, {"other": (1, 2, 3), "nerve": NERVE}, default_tissues({1: "bone", 2: "facial nerve"})]
)
def test_slices_in_the_simulators_colours_must_be_told_their_axes(tmp_path: Path, palette: Any) -> None:
    folder = save(tmp_path / "s", coloured())
    for place in (folder, folder / "plane*.png"):
        refused(
            (lambda place=place: read_stack(place, spacing=0.1, palette=palette),
             r"must be told their axes.*\(--transpose\).*\(--no-transpose\)"),
        )  # fmt: skip
        if isinstance(palette, Tissues):
            refused(
                (lambda place=place: LabelledRecipe(str(place), palette, spacing=(0.1, 0.1, 0.1)),
                 "must be told their axes"),
            )  # fmt: skip
    own = save(tmp_path / "own", np.where(coloured() == NERVE[2], 7, coloured()))
    found = read_stack(
        own, spacing=0.1, palette={"nerve": (*NERVE[:2], 7), "bone": (255, 249, 220)}, unknown=2
    )
    assert found.shape == (3, 4, 5)  # y down the rows


def test_a_map_of_coloured_slices_and_labels_of_grey_ones_are_refused(tmp_path: Path) -> None:
    grey_ones, mapping = save(tmp_path / "grey", grey((3, 4, 5))), OccupancyMap.two_point(0, 255)
    bone = VolumeRecipe(str(grey_ones), mapping, spacing=(0.5, 0.5, 1)).bone()
    np.testing.assert_array_equal(bone.density, grey((3, 4, 5)))
    assert bone.spacing == (0.5, 0.5, 1.0)
    folder = save(tmp_path / "s", coloured())
    recipe = VolumeRecipe(str(folder), mapping, spacing=(0.5, 0.5, 1), transpose=False)
    refused(
        (recipe.bone, "the slices are coloured labels, and a map is of grey values"),
        (
            lambda: labels_of(grey_ones, spacing=(1, 1, 1)),
            "the slices are grey, and labels are coloured ones",
        ),
    )


@needs_yaml
def test_grey_slices_of_a_description_and_recipes_before_the_key(tmp_path: Path) -> None:
    save(tmp_path / "slices", grey((3, 4, 5)))
    recipe = VolumeRecipe(str(adf(tmp_path)), OccupancyMap.two_point(0, 255))
    plain = recipe.plain()
    assert plain["transpose"] is True
    assert VolumeRecipe.of(plain) == recipe
    np.testing.assert_array_equal(recipe.volume().values, grey((3, 4, 5)).swapaxes(1, 2))
    del plain["transpose"]  # as in earlier versions
    np.testing.assert_array_equal(VolumeRecipe.of(plain).volume().values, grey((3, 4, 5)))
    assert "transpose" not in VolumeRecipe("ct.nrrd", recipe.mapping).plain()
    refused(
        (VolumeRecipe("ct.nrrd", recipe.mapping, transpose=True).volume,
         r"transpose \(--transpose\) goes with PNG slices, got .*ct\.nrrd"),
    )  # fmt: skip


def test_colours_in_no_table_are_refused_or_taken_as_asked(tmp_path: Path) -> None:
    planes = coloured()
    planes[1, 2, 0:3] = (*(np.array(BONE) - 2), 255)
    planes[2, 0, 4] = (0, 0, 250, 255)
    folder = save(tmp_path / "s", planes)
    with pytest.raises(
        ValueError,
        match=r"4 pixels of 2 colours that are in no table: \(253, 247, 217\) in plane001.png, row 2, column 0 \(count 3, 3.5 "
        r"from Bone\); \(0, 0, 250\) in plane002.png, row 0, column 4 \(count 1, 63.2 from Stapes\).*but never as a critical",
    ):
        read_stack(folder, spacing=0.1, transpose=False)
    nearest = read_labels(folder, unknown="nearest")
    assert nearest.labels[1, 2, :4].tolist() == [1, 1, 1, 0]
    assert nearest.labels[2, 0, 4] == 1  # nearest is the stapes (63, 0, 255), which is never guessed
    silent, taken, spared = nearest.notes
    assert (silent, [row["pixels"] for row in nearest.unknown_colours]) == (SILENT, [3, 1])
    assert "4 pixels of 2 colours that are in no table were taken as the nearest colour: (2" in taken
    assert "or of what is empty, were taken as Bone (Stapes 1)" in spared
    given = read_labels(folder, unknown=2)
    assert seen(given, (1, 2, 0), (2, 0, 4)) == [2, 2]
    assert "taken as label 2" in given.notes[-1]


def wrapped(*names: str) -> tuple[int, ...]:
    """Colour in volumetric_drilling's slices where structures overlap."""
    return tuple(sum(np.array((*VOLUMETRIC_DRILLING[name], 255)) for name in names) % 256)


@pytest.mark.parametrize(
    ("pair", "winner", "taken"),
    [
        (("Bone", "Chorda_Tympani"), "Chorda_Tympani", "Sinus_+_Dura"),
        (("Bony_Labyrinth", "Sinus_+_Dura"), "Bony_Labyrinth", "ICA"),
        (("Chorda_Tympani", "Facial_Nerve"), "Facial_Nerve", "Inferior_Vestibular_Nerve"),
        (("EAC", "Bone"), "Bone", "EAC"),
    ],
)
@pytest.mark.parametrize("off", [(0, 0, 0), (1, -1, 1)])
def test_overlaps_are_decoded(
    tmp_path: Path, pair: tuple[str, str], winner: str, taken: str, off: tuple[int, int, int]
) -> None:
    names = ["", *VOLUMETRIC_DRILLING]
    planes = coloured()
    planes[2, 1] = (*((np.array(wrapped(*pair)[:3]) + off) % 256), 254)
    folder = save(tmp_path / "s", planes)
    found = read_labels(folder)
    assert [names[i] for i in np.unique(found.labels[2, 1])] == [winner]
    one, other = sorted(pair, key=names.index)
    assert found.notes == (
        SILENT,
        f"voxels of two structures that overlap, by the sum of their colours: 5 of {one} and {other} as "
        f"{winner}",
    )
    assert names[read_labels(folder, unknown="nearest", ranking=None).labels[2, 1, 0]] == taken


def test_overlaps_of_three_are_decoded(tmp_path: Path) -> None:
    names, planes = ["", *VOLUMETRIC_DRILLING], coloured()
    planes[2, 1] = wrapped("Facial_Nerve", "EAC", "Bone")
    planes[1, 2] = wrapped("EAC", "Bone")
    found = read_labels(save(tmp_path / "s", planes))
    assert [names[found.labels[place]] for place in ((2, 1, 0), (1, 2, 0))] == ["Facial_Nerve", "Bone"]
    said = "overlap, by the sum of their colours: "
    assert found.notes[1:] == (
        f"voxels of two structures that {said}5 of Bone and EAC as Bone",
        f"voxels of three structures that {said}5 of Bone, Facial_Nerve and EAC as Facial_Nerve",
    )


def test_stacks_that_earlier_versions_read_keep_their_labels(tmp_path: Path) -> None:
    palette = {"facial nerve": (100, 0, 0), "bone": (0, 90, 0), "yours": (0, 0, 50), "mine": (100, 90, 50)}
    for pixel in ((101, 91, 51, 253), (100, 90, 50, 253)):  # near the sum of three, and a colour of the table
        folder = save(tmp_path / f"{pixel[0]}", np.full((1, 2, 2, 4), pixel, np.uint8))
        for unknown, label in (("nearest", 4), (2, 4 if pixel[0] == 100 else 2)):
            assert read_labels(folder, palette=palette, unknown=unknown).labels[0, 0, 0] == label
    assert read_labels(tmp_path / "100", palette=palette).labels[0, 0, 0] == 4
    del palette["mine"]
    folder = tmp_path / "101"
    choices = [{}, {"unknown": "nearest"}, {"unknown": 3}]
    labels = [read_labels(folder, palette=palette, **choice).labels[0, 0, 0] for choice in choices]
    assert labels == [1, 2, 3]  # decoded; the nerve is critical, so "nearest" gives bone; the label


def test_sums_that_are_not_clearly_one_pair_stay_unknown(tmp_path: Path) -> None:
    palette = {"facial nerve": (100, 0, 0), "bone": (0, 90, 0), "mine": (100, 92, 0), "yours": (0, 0, 50)}
    sums = {
        "one colour": ((100, 90, 0, 254), 0),  # nerve + bone, or mine
        "exact": ((100, 92, 0, 254), 0),
        "clear": ((0, 91, 50, 254), 4),  # bone + yours; yours has no rank and comes before bone
        "of three": ((100, 90, 50, 253), 0),  # a label for unknown colours goes before
        "clipped": ((100, 0, 50, 255), 0),
    }
    for name, (pixel, label) in sums.items():
        folder = save(tmp_path / name, np.full((1, 2, 2, 4), pixel, np.uint8))
        found = read_labels(folder, palette=palette, unknown=0)
        assert (found.labels[0, 0, 0], len(found.unknown_colours)) == (label, label == 0), name
    assert read_labels(tmp_path / "clear", palette=palette, ranking=["bone"]).labels[0, 0, 0] == 4


def test_guesses_that_are_asked_for_are_counted(tmp_path: Path) -> None:
    planes = coloured((3, 4, 12))
    planes[1, 1, 3:5] = planes[1, 1, 11] = (*(np.array(NERVE) - 3), 255)
    planes[1, 1, 0] = (*NERVE, 255)
    folder = save(tmp_path / "s", planes)
    guess, asked = (
        read_labels(folder, spacing=(0.3, 0.1, 0.1), unknown=unknown)
        for unknown in ("nearest", "nearest:facial nerve, ICA")
    )
    assert [(found.labels == 10).sum() for found in (guess, asked)] == [1, 4]
    assert asked.notes[2:] == (
        "3 pixels were taken as Facial_Nerve by their nearest colour, as asked",
        "0 pixels were taken as ICA by their nearest colour, as asked",
    )
    refused(
        (lambda: read_stack(folder, spacing=0.1, unknown="nearest:spleen", transpose=False),
         r"must name structures of the palette, Bone.*got 'nearest:spleen'"),
    )  # fmt: skip


@needs_yaml
def test_a_description_gives_size_and_slices(tmp_path: Path) -> None:
    save(tmp_path / "slices", coloured())
    (tmp_path / "slices" / "notes.txt").write_text("other files do not matter")
    save(tmp_path / "slices", grey((2, 3, 3)), name="preview{}.png")
    labels = read_stack(adf(tmp_path), transpose=False)
    np.testing.assert_allclose(labels.spacing, (10, 10, 10))  # 50, 40, 30 mm over 5 columns, 4 rows, 3 slices
    silent, note = labels.notes
    assert silent == SILENT
    told = f"count in {tmp_path / 'volume.yaml'} is 512, and 3 slices are there: they share its dimensions"
    assert note.startswith(told)
    assert read_stack(adf(tmp_path, count=3)).notes == (SILENT, ROWS_ALONG_X)
    half = read_stack(adf(tmp_path, extra="  scale: 0.5\n"), transpose=False)
    np.testing.assert_allclose(half.spacing, (5, 5, 5))
    old = read_stack(adf(tmp_path, dimensions="{x: 1.0, y: 1.0, z: 1.0}"), unit=49.664)
    np.testing.assert_allclose(old.spacing * (4, 5, 3), 49.664)
    turned = read_stack(adf(tmp_path))  # rows along x, as from the simulator's converter
    np.testing.assert_allclose(turned.spacing, (12.5, 8, 10))


def block(sizes: str, more: str = "") -> str:
    return f"VOLUME a: {{dimensions: {{{sizes}}}, images: {{path: slices, prefix: plane00{more}}}}}"


@needs_yaml
@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a: [", "not a YAML file"),
        ("just text", "must have one block 'VOLUME name' that describes a stack, got none"),
        ("VOLUME a: {}\nVOLUME b: {}",
         "one block 'VOLUME name' that describes a stack, got VOLUME a, VOLUME b"),
        ("VOLUME a: 3", "VOLUME a must have dimensions and images, got 3"),
        ("VOLUME a: {dimensions: {x: 1, y: 1, z: 1}}", "images must be there, a block, got None"),
        ("VOLUME a: {images: {prefix: p}}", "images: path must be there, a text, got None"),
        ("VOLUME a: {images: {path: slices, format: jpg}}", "images: format must be png, got 'jpg'"),
        ("VOLUME a: {images: {path: slices, prefix: [a]}}", r"images: prefix must be a text, got \['a'\]"),
        ("VOLUME a: {images: {path: slices}, images: {path: s}}", "not a YAML file: 'images' stands twice"),
        ("VOLUME a: {images: {path: slices, "
         "count: 0}}", "images: count must be a whole number from 1, got 0"),
        ("VOLUME a: {images: {path: slices}}", "dimensions must be there, a block, got None"),
        ("VOLUME a: {images: {path: s}, dimensions: {x: 1, y: -1, "
         "z: 1}}", "dimensions: y must be a finite number above 0, got -1"),
        ("VOLUME a: {images: {path: s}, dimensions: {x: 1, "
         "y: 1}}", "dimensions: z must be a finite number above 0, got None"),
        ("VOLUME a: {images: {path: s}, dimensions: {x: 1, y: 1, z: 1}, scale: "
         ".nan}", "scale must be a finite number above 0"),
        (f"VOLUME a: {{images: {{path: s}}, dimensions: {{x: 1{400 * '0'}, y: 1, z: 1}}}}", "x must be a finite number above 0"),
        ("VOLUME a: {images: {path: none}, dimensions: {x: 0.1, y: 0.1, z: 0.1}}", "none: no such folder"),
        (block("x: 0.05, y: 0.04, z: 0.03", ", count: 2"), r"images: count must be 3, the slices in .*slices, got 2"),
        # Sides that no head has.
        (block("x: 100, y: 100, z: 100"),
         r"1e\+05 x 1e\+05 x 1e\+05 mm.*in millimetres 100 x 100 x 100 mm \(unit=1\)"),
        (block("x: 1.0, y: 1.0, z: 1.0"),
         r"1000 x 1000 x 1000 mm.*0.049664 m.* 49.66 x 49.66 x 49.66 mm \(unit=49.664\)"),
        (block("x: 0.0001, y: 0.0001, z: 0.0001"),
         "0.1 x 0.1 x 0.1 mm, and a head or a part of one has sides of 2 to 500"),
    ],
)  # fmt: skip
def test_what_is_no_description_is_refused(tmp_path: Path, text: str, match: str) -> None:
    save(tmp_path / "slices", coloured())
    (tmp_path / "v.yaml").write_text(text)
    refused((lambda: read_stack(tmp_path / "v.yaml"), match, (ValueError, FileNotFoundError)))


@needs_yaml
def test_a_description_counts_from_zero_and_knows_the_spacing(tmp_path: Path) -> None:
    (save(tmp_path / "slices", grey((3, 4, 5))) / "plane000.png").unlink()
    refused(
        (lambda: read_stack(adf(tmp_path)), r"slice 0 is missing, the first is plane001\.png"),
        (lambda: read_stack(adf(tmp_path), spacing=0.1), "spacing must not be given with .*volume.yaml"),
    )


def test_without_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "yaml", None)
    refused((lambda: read_stack(adf(tmp_path)), r"PyYAML: pip install 'burrlab\[medical\]'", ImportError))


def png(bits: int, kind: int) -> bytes:
    """A PNG file of one pixel."""
    chunks = b""
    for name, content in (
        (b"IHDR", struct.pack(">IIBBBBB", 1, 1, bits, kind, 0, 0, 0)),
        (b"IDAT", zlib.compress(b"\0" + b"\1\2" * 3)),
        (b"IEND", b""),
    ):
        chunks += struct.pack(">I", len(content)) + name + content
        chunks += struct.pack(">I", zlib.crc32(name + content))
    return b"\x89PNG\r\n\x1a\n" + chunks


#: One colour more than a palette may have.
MANY = {str(n): (1 + n // 65536, n // 256 % 256, n % 256) for n in range(65534)}


def written(pixels: np.ndarray) -> Callable[[Path], None]:
    """A change that writes a slice of these pixels."""
    return lambda path: Image.fromarray(pixels).save(path)


SHORT, DEEP = written(grey()[0][:, :3]), written(grey(kind=np.uint16)[0])


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"plane005.png": Path.unlink, "plane007.png": Path.unlink}, r"s: of the slices 0 to 11, 2 are missing \(5, 7\)"),
        ({"plane007.png": Path.unlink}, "s: of the slices 0 to 11, slice 7 is missing"),
        ({f"plane00{k}.png": Path.unlink for k in (2, 3, 5, 7, 8)}, r"5 are missing \(2, 3, 5, 7, 8\)$"),
        ({f"plane00{k}.png": Path.unlink for k in range(1, 7)}, r"6 are missing \(1, 2, 3, 4, 5, \.\.\.\)$"),
        ({"plane9999999.png": SHORT}, "s: of the slices 0 to 9999999, many are missing"),
        ({"plane000.png": Path.unlink, "plane001.png": Path.unlink},
         "slices 0 to 1 are missing, the first is plane002.png"),
        ({"plane7.png": SHORT}, "slice 7 is there twice"),
        ({"other3.png": SHORT}, r"slices of more than one volume \(other3.png, plane000.png\)"),
        ({"other.png": SHORT}, "other.png: the name of a slice must end in its number"),
        ({"plane006.png": SHORT},
         "plane006.png: slices must be of one size, this one has 3 x 4 pixels, and plane000.png has 5 x 4"),
        ({"plane006.png": DEEP}, "plane006.png: slices must be of one kind, this one is grey of 16 bits, and "
                                 "plane000.png is grey of 8"),
        ({"plane006.png": lambda path: path.write_text("no picture")}, "plane006.png: this is no PNG file"),
        ({"plane006.png": lambda path: os.truncate(path, 50)}, "plane006.png: the PNG file is damaged or cut short"),
        ({"plane006.png": lambda path: path.write_bytes(path.read_bytes()[:16] + b"\xff" * 10 + path.read_bytes()[26:])},
         "plane006.png: the PNG file is damaged"),  # the sizes in its header
    ],
)  # fmt: skip
def test_broken_stacks_are_refused(
    tmp_path: Path, changes: dict[str, Callable[[Path], object]], match: str
) -> None:
    folder = save(tmp_path / "s", grey())
    for name, change in changes.items():
        change(folder / name)
    refused((lambda: read_stack(folder, spacing=0.1), match))


@pytest.mark.parametrize(
    ("place", "kind", "match"),
    [
        ("none", FileNotFoundError, "none: no such folder; a stack of slices is"),
        ("", ValueError, "there are no PNG slices"),
        ("*.png", ValueError, "there are no PNG slices"),
    ],
)
def test_places_without_slices(tmp_path: Path, place: str, kind: type[Exception], match: str) -> None:
    refused((lambda: read_stack(tmp_path / place, spacing=0.1), match, kind))


def test_a_part_of_a_stack_by_a_pattern(tmp_path: Path) -> None:
    part = read_stack(save(tmp_path / "s", grey()) / "plane00[2-4].png", spacing=0.1)
    np.testing.assert_array_equal(part.values, grey()[2:5])


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"palette": {"a": (1, 2, 3), "b": (1, 2, 3)}}, r"colours must differ, 'a' and 'b' are both \(1, 2, 3\)"),
        ({"palette": {"a": (0, 0, 0)}}, "black is label 0"),
        ({"palette": {"a": (1, 2, 300)}}, "three whole numbers from 0 to 255"),
        ({"palette": {"a": (1, 2.5, 3)}}, "three whole numbers from 0 to 255"),
        ({"palette": {}}, "palette must have a colour"),
        ({"palette": MANY}, "palette must have at most 65533 colours, got 65534"),
        ({"palette": {"bone": BONE}, "path": "grey"}, "a palette is for coloured slices, and these are grey"),
        ({"unknown": "skip"}, "unknown must be 'refuse', 'nearest' or a label of the palette"),
        ({"unknown": 17}, "unknown must be 'refuse', 'nearest' or a label of the palette .*got 17"),
        ({"unit": 1.0}, "unit goes with a YAML file"),
        ({"spacing": 0}, "spacing must be a number or three from 1e-6 to 1e6"),
        ({"spacing": None}, r"do not say how large they are: give spacing=\(x, y, z\)"),
        ({"path": "16"}, "colours of labels must have 8 bits a channel, got 16"),
        ({"path": "grey with alpha"}, "s0.png: grey slices must not be transparent"),
    ],
)  # fmt: skip
def test_bad_options_and_kinds_of_pixels_are_refused(
    tmp_path: Path, options: dict[str, Any], match: str
) -> None:
    folder = tmp_path / options.get("path", "colours")
    save(folder, {"colours": coloured(), "grey": grey()}.get(folder.name, []))
    if folder.name in ("16", "grey with alpha"):
        (folder / "s0.png").write_bytes(png(16, 2) if folder.name == "16" else png(8, 4))
    refused((lambda: read_stack(**{"spacing": 0.1, **options, "path": folder}), match))
