"""Stacks of PNG slices: files and their order, colours as labels, and the YAML file of a stack."""

import glob
import itertools
import math
import operator
import os
import re
import struct
import sys
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from burrlab._core import Tissues
from burrlab.bone.dicom import IN_FOLDER, holds_dicom
from burrlab.bone.header import LPS_ASSUMED, medical
from burrlab.bone.image import Colour, LabelVolume, Volume
from burrlab.bone.specimen import checked_spacing
from burrlab.bone.tissues import EMPTY, VOLUMETRIC_DRILLING, known_tissue, plain_name
from burrlab.common.check import check_memory, check_packed, refuse, shown
from burrlab.common.progress import doing
from burrlab.common.records import UNREADABLE

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# PNG specification, 11.2.2 IHDR: name and channels.
_KINDS = {0: ("grey", 1), 2: ("RGB", 3), 3: ("palette", 1), 4: ("grey with alpha", 2), 6: ("RGBA", 4)}
#: Largest side of a slice [pixels] (ours); a file with a larger one counts as damaged.
MOST_PIXELS = 16384


class SliceFiles:
    """Files of equal size and kind, in the order of their numbers; ValueError if they differ, or are of no usable kind.

    Attributes
    ----------
    paths : list of Path
    columns, rows : int
        Size [pixels].
    bits : int
        Bits a channel.
    kind : str
        grey, RGB, palette or RGBA.
    """

    def __init__(self, paths: list[Path]) -> None:
        self.paths, first = paths, _header(paths[0])
        for path in paths[1:]:
            header = _header(path)
            refuse(
                header[:2] != first[:2],
                f"{path}: slices must be of one size, this one has {header[0]} x {header[1]} pixels, and "
                f"{paths[0].name} has {first[0]} x {first[1]}",
            )
            refuse(
                header[2:] != first[2:],
                f"{path}: slices must be of one kind, this one is {header[3]} of {header[2]} bits, and "
                f"{paths[0].name} is {first[3]} of {first[2]} bits",
            )
        self.columns, self.rows, self.bits, self.kind = first
        refuse(
            self.kind == "grey with alpha",
            f"{paths[0]}: grey slices must not be transparent (kind: grey with alpha)",
        )
        refuse(
            self.kind != "grey" and self.bits == 16,
            f"{paths[0]}: colours of labels must have 8 bits a channel, got 16",
        )


def find_slices(place: str | os.PathLike[str], *, prefix: str | None = None) -> SliceFiles:
    """Slices in a folder, or those that a pattern names.

    Parameters
    ----------
    place : path-like
        A folder, or a pattern with *, ? or [...].
    prefix : str, optional
        Text before the number in the names of the files.

    Raises
    ------
    FileNotFoundError
        If there is no such folder.
    ValueError
        If there is no slice; or if a slice is missing, is there twice, is not a PNG file, or differs from the
        first in size or kind.
    """
    text = os.fspath(place)
    in_folder = Path(text).is_dir()
    refuse(
        not in_folder and not any(sign in text for sign in "*?["),
        f"{text}: no such folder; a stack of slices is a folder, a pattern or its YAML file",
        FileNotFoundError,
    )
    pictures = [
        path
        for path in (Path(text).iterdir() if in_folder else map(Path, glob.glob(text)))
        if path.is_file() and path.name.startswith(prefix or "") and not path.name.startswith(".")
        if path.suffix.lower() == ".png" or not in_folder
    ]
    named = "" if prefix is None else f" that begin with {prefix!r}"
    refuse(not pictures, f"{text}: there are no PNG slices{named}")
    # a description counts from 0
    return SliceFiles(_in_order(text, pictures, latest=int(prefix is None) if in_folder else None))


def stack_files(path: str) -> list[str]:
    """All files that a stack is read from."""
    if Path(path).suffix.lower() in _DESCRIPTIONS:
        return [path, *stack_files(str(read_description(path, unit=1.0).folder))]
    parts = Path(path).iterdir() if Path(path).is_dir() else map(Path, glob.glob(path))
    return sorted(str(part) for part in parts if part.suffix.lower() == ".png")


def pixels(path: Path) -> NDArray[Any]:
    """Pixels of a slice, (row, column) or (row, column, channel); ValueError if the file is damaged."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of chunks that it leaves out
            with Image.open(path) as image:
                warnings.simplefilter("error")
                if image.mode in ("P", "RGB"):  # both may make one colour transparent
                    return np.asarray(image.convert("RGBA"))
                if image.mode.startswith("I"):
                    return np.asarray(image).astype(np.uint16)
                return np.asarray(image.convert("L") if image.mode == "1" else image)
    except MemoryError:
        raise ValueError(
            f"{path}: the PNG file is damaged, or the machine has too little memory for it"
        ) from None
    except Exception as error:  # a damaged chunk can raise any error in Pillow
        raise ValueError(f"{path}: the PNG file is damaged or cut short ({error})") from None


def _in_order(place: str, paths: list[Path], *, latest: int | None) -> list[Path]:
    """Files in the order of the numbers at the end of their names; the first may be at most `latest`."""
    numbered: dict[int, Path] = {}
    prefixes: dict[str, Path] = {}
    for path in sorted(paths):
        match = re.fullmatch(r"(.*?)(\d+)", path.stem, flags=re.ASCII)
        if match is None:
            raise ValueError(f"{path}: the name of a slice must end in its number, as slice0012.png")
        prefixes.setdefault(match[1], path)
        refuse(
            len(prefixes) > 1,
            f"{place}: slices of more than one volume ({', '.join(p.name for p in prefixes.values())}): name "
            "one by a pattern, as 'folder/name*.png'",
        )
        number = int(match[2])
        other = numbered.setdefault(number, path)
        refuse(other is not path, f"{place}: slice {number} is there twice ({other.name}, {path.name})")
    order = sorted(numbered)
    far = order[-1] - order[0] >= 10**6
    missing = [] if far else sorted(set(range(order[0], order[-1] + 1)) - set(order))
    numbers_text = ", ".join(map(str, missing[:5])) + (", ..." if len(missing) > 5 else "")
    lost = (
        f"slice {numbers_text} is missing"
        if len(missing) == 1
        else f"{len(missing)} are missing ({numbers_text})"
    )
    refuse(
        missing or far,
        f"{place}: of the slices {order[0]} to {order[-1]}, "
        f"{'many are missing (numbers far apart)' if far else lost}",
    )
    before = "slice 0 is missing" if order[0] == 1 else f"slices 0 to {order[0] - 1} are missing"
    refuse(
        latest is not None and order[0] > latest and not (paths[0].parent / IN_FOLDER).exists(),
        f"{place}: {before}, the first is {numbered[order[0]].name}; a part of a stack is named by a pattern",
    )
    return [numbered[number] for number in order]


def _header(path: Path) -> tuple[int, int, int, str]:
    """Columns, rows, bits and kind from the first chunk."""
    with path.open("rb") as file:
        head = file.read(33)
    refuse(head[:8] != _SIGNATURE or len(head) < 33 or head[12:16] != b"IHDR", f"{path}: this is no PNG file")
    columns, rows, bits, kind = struct.unpack(">IIBB", head[16:26])
    refuse(
        kind not in _KINDS or not (0 < columns <= MOST_PIXELS and 0 < rows <= MOST_PIXELS),
        f"{path}: the PNG file is damaged (its header says {columns} x {rows} pixels, kind {kind})",
    )
    name, channels = _KINDS[kind]
    check_packed(rows * (1 + columns * bits * channels // 8), path.stat().st_size, str(path))
    return columns, rows, bits, name


#: The first of two structures here gets a voxel that both claim (ours). The facial nerve is first. Thin
#: structures come before thick ones, so that none vanishes. Bone comes after them, empty structures last.
RANKING = (
    "facial nerve", "chorda tympani", "cochlear nerve", "superior vestibular nerve", "inferior vestibular nerve",
    "vestibular nerve", "vestibular aqueduct", "stapes", "incus", "malleus", "ossicles", "tympanic membrane",
    "internal auditory canal", "cochlea", "semicircular canals", "labyrinth", "internal carotid artery", "jugular bulb",
    "sigmoid sinus", "sinus and dura", "dura", "brain", "temporomandibular joint", "soft tissue",
    "cortex", "mastoid", "bone", "external auditory canal", "unlabelled", "air",
)  # fmt: skip
_TOLD = 5  # colours in a message; `LabelVolume.unknown_colours` has all
_SUMMED = {2: "two", 3: "three", 4: "four"}  # opaque colours in a sum modulo 256: its alpha is 256 less these
_UNCLEAR = 65535  # number of a sum that no single pair, or no other group, explains; groups have lower ones


class _Sums:
    """Sums of so many colours, and whose a voxel of each is.

    A group's sum must lie within 1 a channel, modulo 256. The sum of no other group of as many, and no
    single colour of the table, may lie within 2.
    """

    def __init__(
        self, colours: Mapping[int, Colour], ranks: Mapping[int, tuple[float, int]], count: int
    ) -> None:
        self.groups = list(itertools.combinations(colours, count))  # of labels
        self.winners = np.array([0, *(min(group, key=ranks.__getitem__) for group in self.groups)])
        singles = np.array([*colours.values(), (0, 0, 0)])
        small, wide = (np.indices((2 * n + 1,) * 3).reshape(3, -1).T - n for n in (1, 2))
        # by the colour's code, a group's number: 0 for none, `_UNCLEAR` for several
        near, self.places = np.zeros((2, 1 << 24), np.uint16)
        single = np.zeros(1 << 24, bool)
        for place, group in enumerate(self.groups, start=1):
            colour = np.sum([colours[label] for label in group], axis=0)
            near[_code((colour + wide) % 256)] += 1
            self.places[_code((colour + small) % 256)] = place
        single[_code((singles[:, None] + wide) % 256)] = True
        self.places[(self.places > 0) & ((near > 1) | single)] = _UNCLEAR
        exact = _code(singles)
        self.places[exact[near[exact] > 0]] = _UNCLEAR


class Palette:
    """A table of colours that counts colours missing from it, and sums of two to four of its colours.

    Parameters
    ----------
    palette, unknown, ranking
        See `read_stack`. 'nearest' gives critical structures, the ear canal and air only where they are named.

    Raises
    ------
    ValueError
        If a colour occurs twice or is no colour, or `unknown` is neither a known word nor a label.
    """

    def __init__(
        self,
        palette: Tissues | Mapping[str, Colour] | None,
        unknown: str | int,
        ranking: Sequence[str] | None,
    ) -> None:
        rows: list[tuple[int, str, Any, Any]] = (
            [(t.label, t.name, t.colour, t.critical) for t in palette]
            if isinstance(palette, Tissues)
            else [
                (i, name, colour, (known := known_tissue(name)) and known.critical)
                for i, (name, colour) in enumerate(
                    (VOLUMETRIC_DRILLING if palette is None else palette).items(), start=1
                )
            ]
        )
        self.names: dict[int, str] = {}
        self.colours: dict[int, Colour] = {}
        seen: dict[Colour, str] = {}
        for label, name, color_text, _ in rows:
            colour = _colour(name, color_text)
            if label == 0:  # always transparent and black
                self.names[0] = name
                continue
            refuse(
                colour in seen,
                f"palette: colours must differ, {seen.get(colour)!r} and {name!r} are both {colour}",
            )
            refuse(colour == (0, 0, 0), f"palette: black is label 0 (nothing), got it for {name!r}")
            seen[colour] = name
            self.names[label], self.colours[label] = name, colour
        refuse(not self.colours, "palette must have a colour")
        self.unknown, self._guessed = _checked_unknown(unknown, {0: "", **self.names})
        self._ranked = {} if ranking is None else self._by_rank(ranking)
        self.dtype = (
            np.uint8 if max(self.colours) < 256 else np.uint16 if max(self.colours) < 65536 else np.int32
        )
        # Number of each possible colour: 0 for black, 1, 2, ... for the table's, the last for all others.
        refuse(len(self.colours) > 65533, f"palette must have at most 65533 colours, got {len(self.colours)}")
        self._strange_place = len(self.colours) + 1
        self._places = np.full(1 << 24, self._strange_place, np.uint16)
        self._places[[0, *(_code(np.array(colour)) for colour in self.colours.values())]] = np.arange(
            self._strange_place
        )
        self._labels = np.array([0, *self.colours, 0], self.dtype)
        # Never guessed: a guess makes no hole, and is no critical structure.
        self._spare = {
            *(label for label, _, _, critical in rows if critical),
            *(label for label in self.colours if _known(self.names[label])[0] in EMPTY),
        }
        self._bones = [i for i in self.colours if _known(self.names[i])[1] and i not in self._spare]
        self._strange: Counter[int] = Counter()
        self._first: dict[int, tuple[str, int, int]] = {}  # first slice, row, column of each strange colour
        self._spared: Counter[int] = Counter()
        self._sums: dict[int, _Sums] = {}  # by the number of colours, made at the first such alpha
        self._overlaps: dict[int, Counter[int]] = {count: Counter() for count in _SUMMED}

    def labels(self, image: NDArray[np.uint8], path: Path) -> NDArray[Any]:
        """Labels of the next slice of RGBA pixels."""
        whole = np.ascontiguousarray(image).view(np.uint32).ravel()
        first = np.flatnonzero(np.append(True, whole[1:] != whole[:-1]))
        runs = np.diff(first, append=whole.size)  # of equal pixels, which are few in labels
        kinds = image.reshape(-1, 4)[first]
        codes = _code(kinds.astype(np.uint32))
        codes[kinds[:, 3] == 0] = 0
        places = self._places.take(codes)
        run_labels = self._labels.take(places)
        strange = places == self._strange_place
        for count in _SUMMED:
            summed = kinds[:, 3] == 256 - count
            if count > 2:  # earlier versions knew two alone: what they read stays as it was
                summed &= strange & (self.unknown == "refuse")
            if not self._ranked or not summed.any() or math.comb(len(self.colours), count) >= _UNCLEAR:
                continue
            if count not in self._sums:
                self._sums[count] = _Sums(self.colours, self._ranked, count)
            sums = self._sums[count].places.take(codes[summed])
            clear = (sums > 0) & (sums < _UNCLEAR)
            run_labels[summed] = np.where(
                clear, self._sums[count].winners.take(np.where(clear, sums, 0)), run_labels[summed]
            )
            strange[summed] = (strange[summed] & ~clear) | (sums == _UNCLEAR)
            self._overlaps[count].update(np.repeat(sums[clear], runs[summed][clear]).tolist())
        labels = np.repeat(run_labels, runs).reshape(image.shape[:2])
        if strange.any():
            codes, strange = (np.repeat(of, runs).reshape(labels.shape) for of in (codes, strange))
            labels[strange] = self._of_strange(codes, strange, path)
        return labels

    def unknown_colours(self) -> tuple[dict[str, Any], ...]:
        """Colours that are in no table, in the form of `LabelVolume.unknown_colours`."""
        order = self._strange.most_common()
        labels, apart = self._nearest(np.array([code for code, _ in order], np.uint32), list(self.colours))
        return tuple(
            {"colour": [code >> 16, (code >> 8) & 255, code & 255], "pixels": count,
             **dict(zip(("slice", "row", "column"), self._first[code], strict=True)),
             "nearest": self.names[label], "distance": round(distance, 1)}
            for (code, count), label, distance in zip(order, labels.tolist(), apart.tolist(), strict=True)
        )  # fmt: skip

    def notes(self, name: str, unknown: Sequence[Mapping[str, Any]]) -> Iterator[str]:
        """Notes on sums and unknown colours; ValueError if unknown colours are refused."""
        for count, overlaps in self._overlaps.items():
            colours_text = "; ".join(
                f"{voxels} of {', '.join(first)} and {last} as {self.names[int(self._sums[count].winners[place])]}"
                for place, voxels in overlaps.most_common()
                for *first, last in [[self.names[label] for label in self._sums[count].groups[place - 1]]]
            )
            if colours_text:
                yield f"voxels of {_SUMMED[count]} structures that overlap, by the sum of their colours: {colours_text}"
        if not unknown:
            return
        pixels, kinds = sum(self._strange.values()), len(unknown)
        many = f"{pixels} pixel{'s' if pixels > 1 else ''} of {kinds} colour{'s' if kinds > 1 else ''} that are in no table"
        colours_text = "; ".join(
            f"{tuple(row['colour'])} in {row['slice']}, row {row['row']}, column {row['column']} (count "
            f"{row['pixels']}, {row['distance']:g} from {row['nearest']})"
            for row in unknown[:_TOLD]
        )
        if kinds > _TOLD:
            colours_text += f"; and {kinds - _TOLD} more colours (`burrlab tissues --json -` lists them)"
        refuse(
            self.unknown == "refuse",
            f"{name}: {many}: {colours_text}; clipped sums of overlapping structures, or blends from scaling? "
            "unknown=LABEL (--unknown LABEL) takes them as that label, 'nearest' as the nearest colour, but "
            "never as a critical structure or empty",
        )
        replacement = "the nearest colour" if self.unknown == "nearest" else f"label {self.unknown}"
        yield f"{many} were taken as {replacement}: {colours_text}"
        if self._spared:
            instead = " or ".join(self.names[i] for i in self._bones) or "label 0: the table has no bone"
            colours_text = ", ".join(f"{self.names[i]} {count}" for i, count in self._spared.most_common())
            yield (
                "pixels whose nearest colour is a critical structure's, or of what is empty, were taken as "
                f"{instead} ({colours_text}); unknown='nearest:NAME' (--unknown nearest:NAME) takes them as that "
                "structure"
            )
        for label, count in self._guessed.items():
            yield f"{count} pixels were taken as {self.names[label]} by their nearest colour, as asked"

    def _of_strange(self, codes: NDArray[np.uint32], strange: NDArray[np.bool_], path: Path) -> NDArray[Any]:
        kinds, first, inverse, counts = np.unique(
            codes[strange], return_index=True, return_inverse=True, return_counts=True
        )
        places = np.flatnonzero(strange)[first].tolist()
        for code, place, count in zip(kinds.tolist(), places, counts.tolist(), strict=True):
            self._first.setdefault(code, (path.name, *divmod(place, strange.shape[1])))
            self._strange[code] += count
        if self.unknown != "nearest":
            return np.full(inverse.shape, 0 if self.unknown == "refuse" else self.unknown)
        assigned = self._nearest(kinds, list(self.colours))[0]
        if self._ranked:
            spared = np.isin(assigned, list(self._spare - self._guessed.keys()))
            for label, count in zip(assigned[spared].tolist(), counts[spared].tolist(), strict=True):
                self._spared[label] += count
            assigned[spared] = self._nearest(kinds[spared], self._bones)[0] if self._bones else 0
        for label in self._guessed:
            self._guessed[label] += int(counts[assigned == label].sum())
        return np.asarray(assigned[inverse])

    def _nearest(self, codes: NDArray[Any], labels: Sequence[int]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Nearest of these labels for each colour, and its distance."""
        triples = np.stack([codes >> 16, (codes >> 8) & 255, codes & 255], axis=-1)
        apart = scipy.spatial.distance.cdist(triples, [self.colours[label] for label in labels])
        return np.array(labels)[apart.argmin(axis=1)], apart.min(axis=1)

    def _by_rank(self, ranking: Sequence[str]) -> dict[int, tuple[float, int]]:
        """Rank of each label: the lower one gets the voxel. Names without a rank come just before bone."""
        order = [_known(name)[0] for name in ranking]
        rest = next((i for i, name in enumerate(order) if _known(name)[1]), len(order)) - 0.5
        ranks = {name: float(i) for i, name in enumerate(order)}
        return {label: (ranks.get(_known(self.names[label])[0], rest), label) for label in self.colours}


def _known(name: str) -> tuple[str, bool]:
    """Usual name of a structure in any spelling, and whether it is bone."""
    known = known_tissue(name)
    return (plain_name(name), False) if known is None else (known.name, known.bone)


def _code(colour: NDArray[Any]) -> Any:
    return (colour[..., 0] << 16) | (colour[..., 1] << 8) | colour[..., 2]


def _colour(name: str, triple: Any) -> Colour:
    try:
        red, green, blue = (operator.index(part) for part in triple)
    except (TypeError, ValueError):
        red = -1
    refuse(
        red < 0 or not all(0 <= part <= 255 for part in (red, green, blue)),
        f"palette: a colour must be three whole numbers from 0 to 255, got {triple!r} for {name!r}",
    )
    return red, green, blue


def _checked_unknown(unknown: str | int, names: Mapping[int, str]) -> tuple[str | int, dict[int, int]]:
    """`unknown` as a word or label, and counts, from 0, of guesses of the labels that it names."""
    if isinstance(unknown, str) and unknown.startswith("nearest:"):
        wanted = {_known(name)[0] for name in unknown[len("nearest:") :].split(",")}
        requested = [label for label, name in names.items() if label and _known(name)[0] in wanted]
        refuse(
            not wanted <= {_known(names[label])[0] for label in requested},
            f"unknown='nearest:NAME' must name structures of the palette, {', '.join(filter(None, names.values()))}, "
            f"got {unknown!r}",
        )
        return "nearest", dict.fromkeys(requested, 0)
    refuse(
        unknown not in ("refuse", "nearest") and (isinstance(unknown, (str, bool)) or unknown not in names),
        "unknown must be 'refuse', 'nearest' or a label of the palette "
        f"({', '.join(map(str, sorted(names)))}), got {unknown!r}",
    )
    return unknown, {}


#: Least and largest plausible side of a head or a part of one [mm] (ours).
PLAUSIBLE = (2.0, 500.0)

#: Most bytes of a description, and most keys of one mapping in it (ours); files of volumetric_drilling have
#: 2 kB.
_LONGEST = 300_000
#: Usual units of a description [mm]; a comment in older files of volumetric_drilling gives 0.049664 m.
_UNITS = {
    "metres": 1000.0, "millimetres": 1.0, "centimetres": 10.0,
    "units of 0.049664 m, as in older files of the simulator": 49.664,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class StackDescription:
    """Content of the YAML file of a stack.

    Attributes
    ----------
    folder : Path
        Folder of the slices.
    prefix : str
        Text before the number in the slices' names.
    count : int or None
        Most slices that the simulator loads.
    extent : ndarray, shape (3,)
        Sides of the volume (x, y, z) [mm].
    """

    folder: Path
    prefix: str
    count: int | None
    extent: NDArray[np.float64]


def read_description(path: str | os.PathLike[str], *, unit: float | None = None) -> StackDescription:
    """Reads the description of a stack.

    Parameters
    ----------
    path : path-like
        A YAML file with a block `VOLUME name` that has `dimensions` (x, y, z), optionally `scale`, and
        `images` (path, prefix, format, count), as in LCSR-SICKKIDS/volumetric_drilling.
    unit : float, optional
        Unit of the dimensions [mm]; default a metre, checked for plausibility.

    Raises
    ------
    ImportError
        Without PyYAML (extra `medical`).
    OSError
        If the file cannot be read.
    ValueError
        If the file is no such description, or the sides are implausible for a head.
    """
    name = os.fspath(path)
    block = _volume_block(name, _content(name))
    images = _part(name, block, "images", dict)
    picture_format, prefix = images.get("format", "png"), images.get("prefix", "")
    refuse(
        not isinstance(picture_format, str) or picture_format.lower().lstrip(".") != "png",
        f"{name}: images: format must be png, got {shown(picture_format)}",
    )
    refuse(
        not isinstance(prefix, str | int | float),
        f"{name}: images: prefix must be a text, got {shown(prefix)}",
    )
    folder = Path(name).parent / str(_part(name, images, "path", str, within="images: "))
    count = images.get("count")
    refuse(
        count is not None and (not isinstance(count, int) or isinstance(count, bool) or count < 1),
        f"{name}: images: count must be a whole number from 1, got {shown(count)}",
    )
    dimensions = _part(name, block, "dimensions", dict)
    sides = np.array([_positive(name, f"dimensions: {axis}", dimensions.get(axis)) for axis in "xyz"])
    sides *= _positive(name, "scale", block.get("scale", 1.0))
    if unit is None:
        _check_plausible(name, sides)
        unit = _UNITS["metres"]
    return StackDescription(folder, str(prefix), count, sides * _positive(name, "unit", unit))


def _content(name: str) -> Any:
    yaml = medical("yaml", "reading YAML", "PyYAML")
    with open(name, "rb") as file:
        content = file.read(_LONGEST + 1)
    refuse(len(content) > _LONGEST, f"{name}: a description must have at most {_LONGEST} bytes")

    class BoundedLoader(yaml.SafeLoader):  # type: ignore[name-defined, misc]
        def flatten_mapping(self, node: Any) -> None:
            super().flatten_mapping(node)
            if len(node.value) > _LONGEST:
                raise yaml.YAMLError(f"a mapping must have at most {_LONGEST} keys, merged ones included")

        def compose_mapping_node(self, anchor: Any) -> Any:
            node = super().compose_mapping_node(anchor)
            keys = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
            if twice := [key for key, count in keys.items() if count > 1]:
                raise yaml.YAMLError(f"{twice[0]!r} stands twice in a mapping")
            return node

    try:
        return BoundedLoader(content).get_single_data()
    except (yaml.YAMLError, *UNREADABLE) as error:
        raise ValueError(f"{name}: not a YAML file: {' '.join(str(error).split())}") from None


def _volume_block(name: str, content: Any) -> dict[str, Any]:
    keys = [key for key in content if str(key).startswith("VOLUME ")] if isinstance(content, dict) else []
    refuse(
        len(keys) != 1,
        f"{name}: must have one block 'VOLUME name' that describes a stack, got "
        f"{', '.join(map(str, keys))[:200] or 'none'}",
    )
    block: dict[str, Any] = content[keys[0]]
    refuse(
        not isinstance(block, dict),
        f"{name}: {str(keys[0])[:200]} must have dimensions and images, got {shown(block)}",
    )
    return block


def _part(name: str, block: dict[str, Any], key: str, kind: type, *, within: str = "") -> Any:
    part = block.get(key)
    refuse(
        not isinstance(part, kind),
        f"{name}: {within}{key} must be there, {'a block' if kind is dict else 'a text'}, got {shown(part)}",
    )
    return part


def _positive(name: str, what: str, value: Any) -> float:
    refuse(
        isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value <= sys.float_info.max,
        f"{name}: {what} must be a finite number above 0, got {shown(value)}",
    )
    return float(value)


def _check_plausible(name: str, sides: NDArray[np.float64]) -> None:
    low, high = PLAUSIBLE
    plausible = {
        what: f"in {what} {_sides(sides * unit)} mm (unit={unit:g})"
        for what, unit in _UNITS.items()
        if np.all((sides * unit >= low) & (sides * unit <= high))
    }
    refuse(
        "metres" not in plausible,
        f"{name}: dimensions in metres would be {_sides(sides * _UNITS['metres'])} mm, and a head or a part of one has "
        f"sides of {low:g} to {high:g} mm; {'; '.join(plausible.values()) or 'in no usual unit it would be one'}: give "
        "unit= [mm]",
    )


def _sides(sides: NDArray[np.float64]) -> str:
    return " x ".join(f"{side:.4g}" for side in sides)


#: Note of a volume read with `transpose`.
ROWS_ALONG_X = "rows of the slices lie along x"
_DESCRIPTIONS = (".yaml", ".yml")


def read_stack(
    path: str | os.PathLike[str],
    *,
    spacing: float | ArrayLike | None = None,
    palette: Tissues | Mapping[str, Colour] | None = None,
    unknown: str | int = "refuse",
    unit: float | None = None,
    transpose: bool | None = None,
    ranking: Sequence[str] | None = RANKING,
) -> Volume | LabelVolume:
    """Reads PNG slices: grey ones as a volume, coloured ones as labels.

    Parameters
    ----------
    path : path-like
        A folder of slices, a pattern ('folder/slice*.png'), or the YAML file that describes them in
        volumetric_drilling. Slices are ordered by the number at the end of their names.
    spacing : float or (x, y, z), optional
        Voxel spacing [mm]; needed without a YAML file.
    palette : Tissues or mapping of str to (r, g, b), optional
        Colours of labels; a mapping gives the labels 1, 2, ... in its order. Default: the sixteen of
        volumetric_drilling.
    unknown : "refuse", "nearest", "nearest:NAME,NAME" or int
        Treatment of colours that are in no table, for example clipped sums or results of scaling: an error
        that names the most frequent, the label of the nearest colour, or this label. With 'nearest', a pixel
        nearest to a critical structure, the ear canal or air becomes bone (label 0 in a table without bone),
        unless the structure is named. The notes of the result count them; `unknown_colours` lists all.
    unit : float, optional
        Unit of the dimensions in a YAML file [mm]; default a metre.
    transpose : bool, optional
        Whether rows of pixels are numbered along x and columns along y, as the simulator's converter from
        NRRD writes them. A wrong value mirrors the ear. Default: True with a YAML file, False for slices
        alone; it must be given for slices alone if their palette has a colour of the simulator.
    ranking : sequence of str, optional
        Usual names of structures: the first of those that claim a voxel gets it. In volumetric_drilling's
        stacks such a pixel has the sum of their colours modulo 256, with alpha 254 for two structures, 253
        for three, 252 for four. Sums of three and four are looked for only if `unknown` is 'refuse': earlier
        versions took them for unknown colours, and their bones must stay the same. Structures without a rank
        come just before bone, the smaller label first. None: such sums are colours in no table, and 'nearest'
        may give any label.

    Returns
    -------
    Volume or LabelVolume
        A volume if the slices are grey, or if no palette is given and all pixels are opaque RGB(A) without
        colour; else labels. Voxel axes: x along a slice's columns to the right, y along its rows downwards, z
        with the slice number; `transpose` exchanges x and y. The origin is the centre of the first pixel of
        the first slice, the direction the identity: slices say no orientation, and the notes say so.

    Raises
    ------
    FileNotFoundError
        If there is no such folder or file.
    ImportError
        Without PyYAML (extra `medical`), for a YAML file.
    ValueError
        If slices are missing, damaged, or of different sizes or kinds; a colour is in no table; the spacing
        is unknown or given twice; the sides in the YAML file are implausible; or `transpose` must be given.

    Notes
    -----
    Transparent and black pixels are label 0. Partly transparent pixels count by their colour.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> from PIL import Image
    >>> folder = tempfile.TemporaryDirectory()
    >>> for k in range(3):
    ...     Image.fromarray(np.full((4, 5), 100 * k, np.uint8)).save(f"{folder.name}/slice{k}.png")
    >>> read_stack(folder.name, spacing=0.1).values.shape
    (3, 4, 5)
    >>> folder.cleanup()
    """
    return stack_of(path, spacing, palette, unknown, unit, transpose, ranking)


@doing("reading slices")
def stack_of(
    path: str | os.PathLike[str],
    spacing: float | ArrayLike | None,
    palette: Tissues | Mapping[str, Colour] | None,
    unknown: str | int,
    unit: float | None,
    transpose: bool | None,
    ranking: Sequence[str] | None,
    *,
    usual: bool = False,
) -> Volume | LabelVolume:
    """As `read_stack`; `usual`: of the default palette, the result has the names of `default_tissues`."""
    name = os.fspath(path)
    described = _description(name, spacing, unit)
    slices = (
        find_slices(path) if described is None else find_slices(described.folder, prefix=described.prefix)
    )
    count = len(slices.paths)
    turned = rows_along_x(name, transpose)
    shape = (count, slices.columns, slices.rows) if turned else (count, slices.rows, slices.columns)
    notes = [f"PNG slices say no orientation: {LPS_ASSUMED}", *([ROWS_ALONG_X] if turned else [])]
    if described is None:
        apart = checked_spacing(cast(ArrayLike, spacing))
    else:
        apart = described.extent / np.array(shape[::-1])
        stated = described.count or count
        refuse(
            count > stated,
            f"{name}: images: count must be {count}, the slices in {described.folder}, got {stated}",
        )
        if count < stated:
            notes.append(
                f"count in {name} is {stated}, and {count} slices are there: they share its dimensions, so slices that "
                "are missing at the end would make the others thicker"
            )
    grid: dict[str, Any] = {
        "spacing": apart, "origin": np.zeros(3), "direction": np.eye(3), "path": name,
    }  # fmt: skip
    if slices.kind == "grey" or (palette is None and all(map(_without_colour, map(pixels, slices.paths)))):
        refuse(
            palette is not None, f"{slices.paths[0]}: a palette is for coloured slices, and these are grey"
        )
        greys = (image[..., 0] if image.ndim == 3 else image for image in map(pixels, slices.paths))
        values = _stacked(name, greys, shape, np.uint16 if slices.bits == 16 else np.uint8, turned)
        return Volume(values, notes=tuple(notes), **grid)
    colours = Palette(palette, unknown, ranking)
    rows_along_x(name, transpose, colours.colours.values())
    planes = (colours.labels(pixels(file), file) for file in slices.paths)
    labels = _stacked(name, planes, shape, colours.dtype, turned)
    if usual and (unknown != "refuse" or not colours.unknown_colours()):  # a refusal has the palette's names
        colours.names = {label: _known(label_name)[0] for label, label_name in colours.names.items()}
    strange = colours.unknown_colours()
    return LabelVolume(
        labels,
        names=colours.names,
        colours=colours.colours,
        notes=(*notes, *colours.notes(name, strange)),
        unknown_colours=strange,
        **grid,
    )


def rows_along_x(name: str, transpose: bool | None, colours: Iterable[Colour] = ()) -> bool:
    """Whether slices are read transposed: as given; else True for a YAML file, False for slices alone.

    ValueError if it must be given: for colours of volumetric_drilling in slices without a YAML file.
    """
    described = Path(name).suffix.lower() in _DESCRIPTIONS
    refuse(
        transpose is None and not described and not set(VOLUMETRIC_DRILLING.values()).isdisjoint(colours),
        f"{name}: slices in colours of volumetric_drilling must be told their axes, a wrong guess mirrors "
        "the ear: transpose=True (--transpose) where rows lie along x, as its converter writes them, else "
        "False (--no-transpose)",
    )
    return described if transpose is None else transpose


def _description(name: str, spacing: float | ArrayLike | None, unit: float | None) -> StackDescription | None:
    """Content of the YAML file; None if the path names the slices themselves."""
    if Path(name).suffix.lower() in _DESCRIPTIONS:
        refuse(
            spacing is not None,
            f"spacing must not be given with {name}, which has dimensions (unit= is their unit)",
        )
        return read_description(name, unit=unit)
    refuse(spacing is None, f"{name}: PNG slices do not say how large they are: give spacing=(x, y, z) [mm]")
    refuse(unit is not None, "unit goes with a YAML file: spacing is in mm")
    return None


def _without_colour(image: NDArray[Any]) -> bool:
    """Whether every pixel is opaque and grey, as in a grey volume written in colours."""
    return bool(np.all(image[..., 3] == 255) and np.all(image[..., :2] == image[..., 1:3]))


def _stacked(
    name: str, planes: Iterable[NDArray[Any]], shape: tuple[int, int, int], kind: type, transpose: bool
) -> NDArray[Any]:
    """The planes one after the other, (z, y, x)."""
    check_memory(float(np.prod(shape)) * np.dtype(kind).itemsize, f"{name}: the volume")
    voxels: NDArray[Any] = np.empty(shape, kind)
    for k, plane in enumerate(planes):
        voxels[k] = plane.T if transpose else plane
    return voxels


def is_stack(path: str) -> bool:
    """Whether a path names PNG slices: a YAML file, a pattern, or a folder with PNG and no DICOM files."""
    return Path(path).suffix.lower() in (*_DESCRIPTIONS, ".png") or (
        Path(path).is_dir() and any(Path(path).glob("*.[pP][nN][gG]")) and not holds_dicom(path)
    )


def stack_slices(path: str) -> SliceFiles | None:
    """PNG slices that a volume was read from; None for other volumes."""
    if Path(path).suffix.lower() in _DESCRIPTIONS and Path(path).is_file():
        described = read_description(path, unit=1.0)
        return find_slices(described.folder, prefix=described.prefix)
    pattern = any(sign in path for sign in "*?[") and not Path(path).exists()
    return find_slices(path) if pattern or (Path(path).is_dir() and is_stack(path)) else None
