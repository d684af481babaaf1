"""Writing a grey volume as a DICOM series, one file a slice (SimpleITK, GDCM).

Tags after DICOM PS3.3, CT Image; UIDs of the form 2.25.<UUID> after PS3.5, annex B.2.
"""

from __future__ import annotations

import hashlib
import os
import uuid
from pathlib import Path

import numpy as np

from burrlab.files import check_folder, new_folder
from burrlab.volume.header import plain_name
from burrlab.volume.volume import Volume

#: Types that are written.
KINDS = ("uint8", "int16", "uint16")
_CT_IMAGE = "1.2.840.10008.5.1.4.1.1.2"


def write_dicom(folder: str | os.PathLike[str], volume: Volume) -> None:
    """Writes a series of CT slices into a new folder, which appears once it is whole.

    Parameters
    ----------
    folder : path-like
        A new folder; its files are slice0001.dcm and so on, along the third voxel axis.
    volume : Volume
        Of uint8, int16 or uint16; right-handed.

    Raises
    ------
    ValueError
        If the values are of another kind, or the direction is left-handed.
    FileExistsError
        If there is something under that name.
    FileNotFoundError
        If the folder in which it is to be made is not there.
    ImportError
        Without SimpleITK (extra `medical`).
    OSError
        If a file cannot be written.

    Notes
    -----
    Patient and study are empty, the image type is DERIVED. The same volume gets the same UIDs. Numbers have up to 16 characters, so the
    geometry comes back to 1e-11 mm.
    """
    target = Path(folder)
    check_slices(volume)
    if target.exists():
        raise FileExistsError(f"folder must be new, {target} is there")
    check_folder(target)
    plain_name(str(target))
    with new_folder(target) as part:
        write_slices(part, volume)


def check_slices(volume: Volume) -> None:
    """ValueError where a volume cannot be written as DICOM; ImportError without SimpleITK."""
    if volume.values.dtype.name not in KINDS:
        raise ValueError(
            f"values must be one of {', '.join(KINDS)} to be written as DICOM, got {volume.values.dtype}"
        )
    if np.linalg.det(volume.direction) < 0:
        raise ValueError("direction must be right-handed to be written as DICOM, got a left-handed one")
    try:
        import SimpleITK  # noqa: F401
    except ImportError as error:
        raise ImportError("writing volumes needs SimpleITK: pip install 'burrlab[medical]'") from error


def write_slices(folder: Path, volume: Volume) -> None:
    """Writes the slices into a folder that is there; OSError where they cannot be written."""
    import SimpleITK as sitk

    content = hashlib.sha256(np.ascontiguousarray(volume.values).tobytes())
    for place in (volume.spacing, volume.origin, volume.direction):
        content.update(place.tobytes())
    shared = {
        "0008|0008": "DERIVED\\SECONDARY",
        "0008|0016": _CT_IMAGE,
        "0008|0060": "CT",
        "0018|0050": f"{volume.spacing[2]:.10g}",
        "0020|000d": uid_of(content.digest() + b"study"),
        "0020|000e": uid_of(content.digest() + b"series"),
        "0020|0052": uid_of(content.digest() + b"frame"),
    }
    writer = sitk.ImageFileWriter()
    writer.SetImageIO("GDCMImageIO")
    writer.KeepOriginalImageUIDOn()
    try:
        for k, pixels in enumerate(volume.values):
            image = sitk.GetImageFromArray(np.ascontiguousarray(pixels[None]))
            image.SetSpacing(volume.spacing.tolist())
            image.SetOrigin((volume.origin + volume.patient_point((0, 0, k * volume.spacing[2]))).tolist())
            image.SetDirection(volume.direction.ravel().tolist())
            own = {"0008|0018": uid_of(content.digest() + b"%d" % k), "0020|0013": str(k + 1)}
            for tag, value in {**shared, **own}.items():
                image.SetMetaData(tag, value)
            writer.SetFileName(str(folder / slice_name(k)))
            writer.Execute(image)
    except RuntimeError as error:
        raise OSError(f"{folder}: the slices cannot be written") from error


def slice_name(k: int) -> str:
    """Name of the file of a slice."""
    return f"slice{k + 1:04d}.dcm"


def uid_of(content: bytes) -> str:
    """A UID that the same content always gets."""
    return f"2.25.{uuid.UUID(bytes=hashlib.sha256(content).digest()[:16]).int}"
