"""Reading volumes and labels: NRRD, NIfTI, MetaImage, and DICOM series (those by SimpleITK, extra `medical`)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike, NDArray

from burrlab.volume.dicom import dicom_files, is_dicom, read_dicom
from burrlab.volume.geometry import checked_direction
from burrlab.volume.header import Header, plain_name, settled_spacing
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.meta_image import read_meta_header
from burrlab.volume.nifti import read_nifti
from burrlab.volume.nrrd import read_nrrd_header, segment_layers
from burrlab.volume.segments import merged, segments_of
from burrlab.volume.stored import read_values
from burrlab.volume.volume import Volume

#: A file, a folder of DICOM slices, or the slices.
VolumePath = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

_NIFTI = (".nii", ".nii.gz", ".hdr", ".img")
_HEADERS = {
    ".nrrd": read_nrrd_header,
    ".nhdr": read_nrrd_header,
    ".mha": read_meta_header,
    ".mhd": read_meta_header,
}


def read_volume(
    path: VolumePath, *, spacing: float | ArrayLike | None = None, series: str | None = None
) -> Volume:
    """Reads a grey volume: NRRD, NIfTI, MetaImage, a DICOM series.

    Parameters
    ----------
    path : path, or sequence of paths
        A file; a folder with a DICOM series; or the files of one, in any order.
    spacing : float or (x, y, z), optional
        Voxel spacing where the file has none [mm].
    series : str, optional
        SeriesInstanceUID, where a folder holds more than one.

    Returns
    -------
    Volume
        In patient coordinates, LPS [mm]. Its `notes` say what was assumed: an orientation that the file does not have.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ImportError
        Without SimpleITK (extra `medical`), for DICOM.
    ValueError
        If the file cannot be read whole, says more than it holds or the machine has memory for, is not a three-dimensional volume of one finite value a voxel, does not say its spacing
        and none is given, or says another; if its direction matrix is not orthonormal; or if slices are missing, doubled,
        uneven, sheared or not alike, or of several series.
    """
    name, header, values = _read(path, spacing, series)
    return Volume(
        values, settled_spacing(header, spacing, name), header.origin, header.direction, name, header.notes, header.files
    )  # fmt: skip


def read_labels(
    path: VolumePath, *, spacing: float | ArrayLike | None = None, series: str | None = None
) -> LabelVolume:
    """Reads a label volume: the formats, parameters and errors of `read_volume`.

    Returns
    -------
    LabelVolume
        With the names and colours that the header of a segmentation by 3D Slicer (.seg.nrrd) has.

    Raises
    ------
    FileNotFoundError, ImportError
        As `read_volume`.
    ValueError
        As `read_volume`; or if a value is not whole, or segments overlap.
    """
    if isinstance(path, str | os.PathLike) and os.fspath(path).lower().endswith((".nrrd", ".nhdr")):
        _check_there(os.fspath(path))
        layers, fields = segment_layers(os.fspath(path))
        if layers > 1:
            return _layered(os.fspath(path), layers, fields, spacing)
    name, header, values = _read(path, spacing, series)
    return LabelVolume(
        values, settled_spacing(header, spacing, name), header.origin, header.direction, name, header.names,
        header.colours, header.notes, header.files,
    )  # fmt: skip


def _layered(
    name: str, layers: int, fields: dict[str, str], spacing: float | ArrayLike | None
) -> LabelVolume:
    """A segmentation whose segments lie in several layers."""
    header = read_nrrd_header(name, layers=True)
    checked_direction(header.direction, name)
    try:
        values = read_values(name, (*header.shape, layers))
        labels, names, colours, notes = merged(values, segments_of(fields, layers=layers))
    except ValueError as error:
        raise error if str(error).startswith(name) else ValueError(f"{name}: {error}") from None
    return LabelVolume(
        labels, settled_spacing(header, spacing, name), header.origin, header.direction, name, names, colours,
        (*header.notes, *notes),
    )  # fmt: skip


def _read(
    path: VolumePath, spacing: float | ArrayLike | None, series: str | None
) -> tuple[str, Header, NDArray[Any]]:
    if not isinstance(path, str | os.PathLike):
        names = [os.fspath(part) for part in path]
        if not names:
            raise ValueError("path must name a file, got an empty list")
        for name in names:
            _check_there(name)
        _check_simpleitk()
        where = (
            f"{len(names)} files in {os.path.commonpath([os.path.dirname(n) or '.' for n in names]) or '.'}"
        )
        return where, *read_dicom(names, where, series)
    name = os.fspath(path)
    if Path(name).is_dir():
        _check_simpleitk()
        files, others = dicom_files(name)
        return name, *read_dicom(files, name, series, others)
    _check_there(name)
    if is_dicom(name):
        _check_simpleitk()
        return name, *read_dicom([name], name, series)
    if series is not None:
        raise ValueError(f"series goes with DICOM, got {name}")
    if name.lower().endswith(_NIFTI):
        return name, *read_nifti(name)
    read_header = _HEADERS.get(Path(name).suffix.lower())
    if read_header is None:
        raise ValueError(
            f"{name}: cannot be read as a volume: it must be a folder of DICOM slices or end in one of "
            f"{', '.join([*_HEADERS, *_NIFTI])}"
        )
    header = read_header(plain_name(name))
    checked_direction(header.direction, name)
    settled_spacing(header, spacing, name)
    return name, header, read_values(name, header.shape)


def _check_there(name: str) -> None:
    if not Path(name).is_file():
        raise FileNotFoundError(f"{name}: no such file")


def _check_simpleitk() -> None:
    try:
        import SimpleITK  # noqa: F401
    except ImportError as error:
        raise ImportError("reading DICOM needs SimpleITK: pip install 'burrlab[medical]'") from error
