"""Volumes as stacks of PNG slices: grey values, or labels as colours."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import Tissues
from burrlab.bounds import check_memory
from burrlab.volume.adf import StackDescription, read_description
from burrlab.volume.dicom import holds_dicom
from burrlab.volume.geometry import checked_spacing
from burrlab.volume.header import LPS_ASSUMED
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.palette import RANKING, Colours, Palette
from burrlab.volume.png_files import Slices, find_slices, pixels
from burrlab.volume.volume import Volume

#: Note of a volume that was read with `transpose`.
ROWS_ALONG_X = "rows of the slices lie along x"
_DESCRIPTIONS = (".yaml", ".yml")


def read_stack(
    path: str | os.PathLike[str],
    *,
    spacing: float | ArrayLike | None = None,
    palette: Tissues | Mapping[str, Colours] | None = None,
    unknown: str | int = "refuse",
    unit: float | None = None,
    transpose: bool | None = None,
    ranking: Sequence[str] | None = RANKING,
) -> Volume | LabelVolume:
    """Reads PNG slices: grey ones as a volume, coloured ones as labels.

    Parameters
    ----------
    path : path-like
        A folder of slices, a pattern ('folder/slice*.png'), or the YAML file that describes them in volumetric_drilling.
        Slices are in the order of the number that ends their names.
    spacing : float or (x, y, z), optional
        Of voxels [mm]; needed unless a YAML file says how large the volume is.
    palette : Tissues or mapping of str to (r, g, b), optional
        Colours of labels; a mapping gives the labels 1, 2, ... in its order. Default: the sixteen of volumetric_drilling.
    unknown : "refuse", "nearest", "nearest:NAME,NAME" or int
        What becomes of colours that are in no table, as clipped sums or scaling leave them: an error with the largest of them, the
        label of the nearest colour, or this label. A pixel whose nearest colour is that of a critical structure, the ear canal or air
        becomes bone (label 0 in a table without bone), but for structures that are named. The notes of the result say how many; `unknown_colours` lists all.
    unit : float, optional
        Of the dimensions in a YAML file [mm]; default a metre.
    transpose : bool, optional
        True where the number of a pixel's row counts along x and that of its column along y, as the simulator's converter
        from NRRD writes them. A wrong one mirrors the ear. Default: True of a YAML file, False of slices alone; those must be told
        where their palette has a colour of the simulator's.
    ranking : sequence of str, optional
        Which of two structures gets a voxel that both claim, by their usual names: the first. In volumetric_drilling's stacks such
        a pixel has the sum of their colours modulo 256, with alpha 254. What is not ranked comes just before bone, the smaller label
        first. None: such sums are colours in no table, and 'nearest' takes any, as before there was a ranking.

    Returns
    -------
    Volume or LabelVolume
        Grey where the slices are grey, or are RGB(A), opaque and without a colour throughout and no palette is given; else
        labels. Voxel axes: x along the columns of a slice to the right, y along its rows downwards, z with the number; x and y
        change places with `transpose`. The centre of the first slice's first pixel is the origin, the direction that of the
        voxel axes: slices say no orientation, and the notes say so.

    Raises
    ------
    FileNotFoundError
        If there is no such folder or file.
    ImportError
        Without PyYAML (extra `medical`), for a YAML file.
    ValueError
        If slices are missing, damaged, or of different sizes or kinds, a colour is in no table, the spacing is unknown or said
        twice, no head has the sides that the YAML file says, or `transpose` must be told.

    Notes
    -----
    Transparent and black pixels are label 0, whatever their colour. Partly transparent ones count by their colour.
    """
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
        assert spacing is not None
        apart = checked_spacing(spacing)
    else:
        apart = described.extent / np.array(shape[::-1])
        if described.count is not None and described.count != count:
            if count > described.count:
                raise ValueError(
                    f"{name}: images: count must be {count}, the slices in {described.folder}, got {described.count}"
                )
            notes.append(
                f"count in {name} is {described.count}, and {count} slices are there: they share its dimensions, so slices that are "
                "missing at the end would make the others thicker"
            )
    grid: dict[str, Any] = {
        "spacing": apart, "origin": np.zeros(3), "direction": np.eye(3), "path": name,
    }  # fmt: skip
    if slices.kind == "grey" or (palette is None and _without_colour(slices)):
        if palette is not None:
            raise ValueError(f"{slices.paths[0]}: a palette is for coloured slices, and these are grey")
        check_memory(float(np.prod(shape)) * max(slices.bits // 8, 1), f"{name}: the volume")
        return Volume(_grey(slices, turned), notes=tuple(notes), **grid)
    colours = Palette.of(palette, unknown, ranking)
    rows_along_x(name, transpose, colours.colours.values())
    check_memory(float(np.prod(shape)) * np.dtype(colours.dtype).itemsize, f"{name}: the volume")
    labels = np.empty(shape, colours.dtype)
    for k, file in enumerate(slices.paths):
        plane = colours.labels(pixels(file), file)
        labels[k] = plane.T if turned else plane
    strange = colours.unknown_colours()
    rows = labels.transpose(0, 2, 1) if turned else labels
    notes.extend(colours.notes(name, strange, rows, apart[[2, 0, 1] if turned else [2, 1, 0]]))
    return LabelVolume(
        labels,
        names=colours.names,
        colours=colours.colours,
        notes=tuple(notes),
        unknown_colours=strange,
        **grid,
    )


def rows_along_x(name: str, transpose: bool | None, colours: Iterable[Colours] = ()) -> bool:
    """Whether slices are read transposed: as told, else by their kind.

    ValueError where they must be told: the colours of volumetric_drilling in slices without its YAML file.
    """
    described = Path(name).suffix.lower() in _DESCRIPTIONS
    if transpose is None and not described:
        from burrlab.anatomy.known_tissues import VOLUMETRIC_DRILLING  # anatomy builds on volumes

        if not set(VOLUMETRIC_DRILLING.values()).isdisjoint(colours):
            raise ValueError(
                f"{name}: slices in colours of volumetric_drilling must be told their axes, a wrong guess mirrors the ear: "
                "transpose=True (--transpose) where rows lie along x, as its converter writes them, else False (--no-transpose)"
            )
    return described if transpose is None else transpose


def _description(name: str, spacing: float | ArrayLike | None, unit: float | None) -> StackDescription | None:
    """What a YAML file says; None where the slices are named themselves, with their spacing."""
    if Path(name).suffix.lower() in _DESCRIPTIONS:
        if spacing is not None:
            raise ValueError(
                f"spacing must not be given with {name}, which has dimensions (unit= is their unit)"
            )
        return read_description(name, unit=unit)
    if spacing is None:
        raise ValueError(f"{name}: PNG slices do not say how large they are: give spacing=(x, y, z) [mm]")
    if unit is not None:
        raise ValueError("unit goes with a YAML file: spacing is in mm")
    checked_spacing(spacing)
    return None


def _without_colour(slices: Slices) -> bool:
    """Whether every pixel is opaque and grey: a grey volume that was written as colours."""
    for path in slices.paths:
        image = pixels(path)
        if np.any(image[..., 3] != 255) or np.any(image[..., :2] != image[..., 1:3]):
            return False
    return True


def _grey(slices: Slices, transpose: bool) -> NDArray[Any]:
    values = None
    for k, path in enumerate(slices.paths):
        image = pixels(path)
        plane = image[..., 0] if image.ndim == 3 else image
        plane = plane.T if transpose else plane
        if values is None:
            values = np.empty((len(slices.paths), *plane.shape), plane.dtype)
        values[k] = plane
    assert values is not None
    return values


def is_stack(path: str) -> bool:
    """Whether it is PNG slices: their description, a pattern of names, or a folder of them without DICOM files."""
    if Path(path).suffix.lower() in (".yaml", ".yml", ".png"):
        return True
    return Path(path).is_dir() and any(Path(path).glob("*.[pP][nN][gG]")) and not holds_dicom(path)
