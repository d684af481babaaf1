"""Colours of slices to labels, sums of two of them, and what becomes of colours that are in no table."""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from burrlab._core import Tissues

Colours = tuple[int, int, int]

#: Which of two structures gets a voxel that both claim, the first of them (ours): the facial nerve, then thin before thick, so
#: that no structure vanishes in a thicker one, and bone behind all of them, but before what is empty.
RANKING = (
    "facial nerve", "chorda tympani", "cochlear nerve", "superior vestibular nerve", "inferior vestibular nerve",
    "vestibular nerve", "vestibular aqueduct", "stapes", "incus", "malleus", "ossicles", "tympanic membrane",
    "internal auditory canal", "cochlea", "semicircular canals", "labyrinth", "internal carotid artery", "jugular bulb",
    "sigmoid sinus", "sinus and dura", "dura", "brain", "temporomandibular joint", "soft tissue",
    "cortex", "mastoid", "bone", "external auditory canal", "unlabelled", "air",
)  # fmt: skip
_EMPTY = ("external auditory canal", "air")  # a guess makes no hole
_TOLD = 5  # colours in a sentence; `LabelVolume.unknown_colours` has all
_TWICE = 254  # alpha of the sum of two opaque colours, modulo 256
_UNCLEAR = 65535  # the place of sums that are not clearly one pair's
_MOST_PAIRED = 361  # colours whose pairs have places below that


class Palette:
    """A table of colours that keeps count of those which are not in it, and of sums of two of them.

    Parameters
    ----------
    rows : iterable of (int, str, (r, g, b))
        Label, name and colour.
    unknown, ranking
        See `read_stack`.
    critical : iterable of int
        Labels that no guess makes, nor an ear canal or air.

    Raises
    ------
    ValueError
        If a colour occurs twice or is none, or `unknown` is neither of its words nor a label.
    """

    def __init__(
        self,
        rows: Iterable[tuple[int, str, Any]],
        unknown: str | int = "refuse",
        ranking: Sequence[str] | None = None,
        critical: Iterable[int] = (),
    ) -> None:
        self.names: dict[int, str] = {}
        self.colours: dict[int, Colours] = {}
        seen: dict[Colours, str] = {}
        for label, name, given in rows:
            colour = _colour(name, given)
            if label == 0:  # transparent and black, whatever the table says
                self.names[0] = name
                continue
            if colour in seen:
                raise ValueError(
                    f"palette: colours must differ, {seen[colour]!r} and {name!r} are both {colour}"
                )
            if colour == (0, 0, 0):
                raise ValueError(f"palette: black is label 0 (nothing), got it for {name!r}")
            seen[colour] = name
            self.names[label], self.colours[label] = name, colour
        if not self.colours:
            raise ValueError("palette must have a colour")
        self.unknown, self._asked = _checked_unknown(unknown, {0: "", **self.names})
        self._ranked = None if ranking is None else self._by_rank(ranking)
        self.dtype = (
            np.uint8 if max(self.colours) < 256 else np.uint16 if max(self.colours) < 65536 else np.int32
        )
        # A place for each colour there is: 0 for black, 1, 2, ... for the table's, the last for all others.
        if len(self.colours) > 65533:
            raise ValueError(f"palette must have at most 65533 colours, got {len(self.colours)}")
        self._strange_place = len(self.colours) + 1
        self._places = np.full(1 << 24, self._strange_place, np.uint16)
        self._places[[0, *(_code(np.array(colour)) for colour in self.colours.values())]] = np.arange(
            self._strange_place
        )
        self._labels = np.array([0, *self.colours, 0], self.dtype)
        self._spare = {*critical, *(i for i in self.colours if _known(self.names[i])[0] in _EMPTY)}
        self._bones = [i for i in self.colours if _known(self.names[i])[1] and i not in self._spare]
        self._strange: Counter[int] = Counter()
        self._first: dict[int, tuple[str, int, int]] = {}  # of each strange colour: slice, row, column
        self._guessed: dict[int, list[NDArray[Any]]] = {label: [] for label in self._asked}
        self._spared: Counter[str] = Counter()
        self._sums: NDArray[np.uint16] | None = None  # a place for each pair, made when alpha 254 is met
        self._overlaps: Counter[int] = Counter()
        self._slices = 0

    @classmethod
    def of(
        cls,
        palette: Tissues | Mapping[str, Colours] | None,
        unknown: str | int,
        ranking: Sequence[str] | None,
    ) -> Palette:
        """The palette of a table of tissues, or of names and colours, or of volumetric_drilling."""
        # anatomy builds on volumes
        from burrlab.anatomy.known_tissues import VOLUMETRIC_DRILLING, known_tissue

        if isinstance(palette, Tissues):
            critical = [t.label for t in palette if t.critical]
            return cls(((t.label, t.name, t.colour) for t in palette), unknown, ranking, critical)
        named = VOLUMETRIC_DRILLING if palette is None else palette
        critical = [i for i, name in enumerate(named, 1) if (known := known_tissue(name)) and known.critical]
        rows = ((i, name, colour) for i, (name, colour) in enumerate(named.items(), start=1))
        return cls(rows, unknown, ranking, critical)

    def labels(self, image: NDArray[np.uint8], path: Path) -> NDArray[Any]:
        """Labels of the next slice of RGBA pixels."""
        codes = _code(image[..., :3].astype(np.uint32))
        codes[image[..., 3] == 0] = 0
        places = self._places.take(codes)
        found: NDArray[Any] = self._labels.take(places)
        strange = places == self._strange_place
        twice = image[..., 3] == _TWICE
        if self._ranked is not None and len(self.colours) <= _MOST_PAIRED and twice.any():
            self._sums = self._places_of_sums() if self._sums is None else self._sums
            sums = self._sums.take(codes[twice])
            pair = (sums > 0) & (sums < _UNCLEAR)
            found[twice] = np.where(pair, self._winners[np.where(pair, sums, 0)], found[twice])
            strange[twice] = (strange[twice] & ~pair) | (sums == _UNCLEAR)
            self._overlaps.update(sums[pair].tolist())
        if strange.any():
            found[strange] = self._of_strange(codes, strange, path)
        self._slices += 1
        return found

    def unknown_colours(self) -> tuple[dict[str, Any], ...]:
        """The colours that are in no table, as `LabelVolume.unknown_colours` has them."""
        order = self._strange.most_common()
        labels, apart = self._nearest(np.array([code for code, _ in order], np.uint32), list(self.colours))
        found = []
        for (code, count), label, distance in zip(order, labels.tolist(), apart.tolist(), strict=True):
            file, row, column = self._first[code]
            found.append(
                {"colour": [code >> 16, (code >> 8) & 255, code & 255], "pixels": count, "slice": file, "row": row,
                 "column": column, "nearest": self.names[label], "distance": round(distance, 1)}
            )  # fmt: skip
        return tuple(found)

    def notes(
        self, name: str, unknown: Sequence[Mapping[str, Any]], labels: NDArray[Any], apart: NDArray[Any]
    ) -> list[str]:
        """What was done with sums and with unknown colours, of labels (slice, row, column); ValueError where these are refused."""
        notes = []
        if self._overlaps:
            told = "; ".join(
                f"{count} of {self.names[one]} and {self.names[other]} as {self.names[int(self._winners[place])]}"
                for place, count in self._overlaps.most_common()
                for one, other in [self._pairs[place - 1]]
            )
            notes.append(f"voxels of two structures that overlap, by the sum of their colours: {told}")
        if not unknown:
            return notes
        pixels, kinds = sum(self._strange.values()), len(unknown)
        many = f"{pixels} pixel{'s' if pixels > 1 else ''} of {kinds} colour{'s' if kinds > 1 else ''} that are in no table"
        told = "; ".join(
            f"{tuple(row['colour'])} in {row['slice']}, row {row['row']}, column {row['column']} (count {row['pixels']}, "
            f"{row['distance']:g} from {row['nearest']})"
            for row in unknown[:_TOLD]
        )
        if kinds > _TOLD:
            told += f"; and {kinds - _TOLD} more colours (`burrlab tissues --json -` lists them)"
        if self.unknown == "refuse":
            raise ValueError(
                f"{name}: {many}: {told}; sums of structures that overlap, clipped, or blends of scaling? unknown=LABEL "
                "(--unknown LABEL) takes them as that label, 'nearest' as the nearest colour, but never as a critical structure or empty"
            )
        taken = "the nearest colour" if self.unknown == "nearest" else f"label {self.unknown}"
        notes.append(f"{many} were taken as {taken}: {told}")
        if self._spared:
            instead = " or ".join(self.names[i] for i in self._bones) or "label 0: the table has no bone"
            told = ", ".join(f"{name} {count}" for name, count in self._spared.most_common())
            notes.append(
                f"pixels whose nearest colour is a critical structure's, or of what is empty, were taken as {instead} ({told}); "
                "unknown='nearest:NAME' (--unknown nearest:NAME) takes them as that structure"
            )
        return notes + [self._far(label, places, labels, apart) for label, places in self._guessed.items()]

    def _of_strange(self, codes: NDArray[np.uint32], strange: NDArray[np.bool_], path: Path) -> NDArray[Any]:
        kinds, first, inverse, counts = np.unique(
            codes[strange], return_index=True, return_inverse=True, return_counts=True
        )
        where = np.flatnonzero(strange)
        for code, place, count in zip(kinds.tolist(), where[first].tolist(), counts.tolist(), strict=True):
            self._first.setdefault(code, (path.name, *divmod(place, strange.shape[1])))
            self._strange[code] += count
        if self.unknown != "nearest":
            return np.full(inverse.shape, 0 if self.unknown == "refuse" else self.unknown)
        taken = self._nearest(kinds, list(self.colours))[0]
        if self._ranked is not None:
            spared = np.isin(taken, list(self._spare - set(self._asked)))
            for label, count in zip(taken[spared].tolist(), counts[spared].tolist(), strict=True):
                self._spared[self.names[label]] += count
            taken[spared] = self._nearest(kinds[spared], self._bones)[0] if self._bones else 0
        for label, places in self._guessed.items():
            here = where[(taken == label)[inverse]]
            places.append(
                np.insert(np.stack(divmod(here, strange.shape[1]), axis=-1), 0, self._slices, axis=1)
            )
        return np.asarray(taken[inverse])

    def _nearest(self, codes: NDArray[Any], labels: Sequence[int]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Of each colour the nearest of these labels, and how far that is."""
        own = np.stack([codes >> 16, (codes >> 8) & 255, codes & 255], axis=-1)
        apart = cdist(own, [self.colours[label] for label in labels])
        return np.array(labels)[apart.argmin(axis=1)], apart.min(axis=1)

    def _by_rank(self, ranking: Sequence[str]) -> dict[int, tuple[float, int]]:
        """By label what is least of the structure that gets a voxel; names that are not ranked come just before bone."""
        order = [_known(name)[0] for name in ranking]
        rest = next((i for i, name in enumerate(order) if _known(name)[1]), len(order)) - 0.5
        ranks = {name: float(i) for i, name in enumerate(order)}
        return {label: (ranks.get(_known(self.names[label])[0], rest), label) for label in self.colours}

    def _places_of_sums(self) -> NDArray[np.uint16]:
        """For each colour with alpha 254: the pair whose sum it is, from 1; 0 for none; or that it is not clear.

        A pair's sum lies within 1 a channel, modulo 256, and no other pair's, nor one colour of the table, within 2.
        """
        assert self._ranked is not None
        labels, colours = list(self.colours), np.array(list(self.colours.values()))
        one, other = np.triu_indices(len(labels), 1)
        self._pairs = [(labels[i], labels[j]) for i, j in zip(one, other, strict=True)]
        self._winners = np.array([0, *(min(pair, key=self._ranked.__getitem__) for pair in self._pairs)])
        sums, singles = colours[one] + colours[other], np.vstack([colours, np.zeros((1, 3), int)])
        small, wide = (np.indices((2 * n + 1,) * 3).reshape(3, -1).T - n for n in (1, 2))
        near, places = np.zeros((2, 1 << 24), np.uint16)
        single = np.zeros(1 << 24, bool)
        for place, colour in enumerate(sums, start=1):
            near[_code((colour + wide) % 256)] += 1
            places[_code((colour + small) % 256)] = place
        for colour in singles:
            single[_code((colour + wide) % 256)] = True
        places[(places > 0) & ((near > 1) | single)] = _UNCLEAR
        exact = _code(singles)
        places[exact[near[exact] > 0]] = _UNCLEAR
        return np.asarray(places)

    def _far(self, label: int, places: list[NDArray[Any]], labels: NDArray[Any], apart: NDArray[Any]) -> str:
        """How far the voxels that were guessed to be a structure lie from the rest of it."""
        guessed, rest = np.concatenate(places), labels == label
        rest[tuple(guessed.T)] = False
        said = f"{len(guessed)} pixels were taken as {self.names[label]} by their nearest colour, as asked"
        if not (len(guessed) and rest.any()):
            return f"{said}; {np.count_nonzero(rest)} others are there"
        surface = np.argwhere(rest & ~binary_erosion(rest))
        far = np.asarray(cKDTree(surface * apart).query(guessed * apart)[0])
        return f"{said}: up to {far.max():.3g} mm from the rest of it, {np.count_nonzero(far > 1)} of them beyond 1 mm"


def _known(name: str) -> tuple[str, bool]:
    """The usual name of a structure, in any spelling, and whether it is bone."""
    from burrlab.anatomy.known_tissues import known_tissue, plain_name

    known = known_tissue(name)
    return (plain_name(name), False) if known is None else (known.name, known.bone)


def _code(colour: NDArray[Any]) -> Any:
    return (colour[..., 0] << 16) | (colour[..., 1] << 8) | colour[..., 2]


def _colour(name: str, given: Any) -> Colours:
    try:
        red, green, blue = (operator.index(part) for part in given)
    except (TypeError, ValueError):
        red = -1
    if red < 0 or not all(0 <= part <= 255 for part in (red, green, blue)):
        raise ValueError(
            f"palette: a colour must be three whole numbers from 0 to 255, got {given!r} for {name!r}"
        )
    return red, green, blue


def _checked_unknown(unknown: str | int, names: Mapping[int, str]) -> tuple[str | int, list[int]]:
    """The word or label, and the labels that are asked for by name."""
    if unknown in ("refuse", "nearest") or (not isinstance(unknown, (str, bool)) and unknown in names):
        return unknown, []
    if isinstance(unknown, str) and unknown.startswith("nearest:"):
        wanted = {_known(name)[0] for name in unknown[len("nearest:") :].split(",")}
        asked = [label for label, name in names.items() if label and _known(name)[0] in wanted]
        if wanted <= {_known(names[label])[0] for label in asked}:
            return "nearest", asked
        have = ", ".join(filter(None, names.values()))
        raise ValueError(
            f"unknown='nearest:NAME' must name structures of the palette, {have}, got {unknown!r}"
        )
    raise ValueError(
        f"unknown must be 'refuse', 'nearest' or a label of the palette ({', '.join(map(str, sorted(names)))}), got {unknown!r}"
    )
