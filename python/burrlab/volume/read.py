"""Reading volumes and labels from files, whatever the format."""

from __future__ import annotations

import gzip
import math
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.volume import Volume


def read_volume(path: str | os.PathLike[str]) -> Volume:
    """Reads a grey volume: NRRD, NIfTI, MetaImage."""
    name, image = _read(path)
    import SimpleITK as sitk

    return Volume(
        values=sitk.GetArrayFromImage(image),
        spacing=np.array(image.GetSpacing()),
        origin=np.array(image.GetOrigin()),
        direction=np.array(image.GetDirection()).reshape(3, 3),
        path=name,
    )


def read_labels(path: str | os.PathLike[str]) -> LabelVolume:
    """Reads a label volume: NRRD, NIfTI, MetaImage."""
    name, image = _read(path)
    import SimpleITK as sitk

    return LabelVolume(
        labels=sitk.GetArrayFromImage(image),
        spacing=np.array(image.GetSpacing()),
        origin=np.array(image.GetOrigin()),
        direction=np.array(image.GetDirection()).reshape(3, 3),
        path=name,
    )


def _read(path: str | os.PathLike[str]) -> tuple[str, Any]:
    name = os.fspath(path)
    if not Path(name).is_file():
        raise FileNotFoundError(f"{name}: no such file")
    try:
        import SimpleITK as sitk
    except ImportError as error:
        raise ImportError("reading volumes needs SimpleITK: pip install 'burrlab[medical]'") from error
    _check_whole(name)
    try:
        image = sitk.ReadImage(name)
    except RuntimeError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        detail = lines[-1] if lines else "unknown error"
        raise ValueError(f"{name}: cannot be read as a volume: {detail}") from error
    if image.GetDimension() != 3 or image.GetNumberOfComponentsPerPixel() != 1:
        raise ValueError(
            f"{name}: a volume needs three dimensions and one value a voxel, got {image.GetDimension()} dimensions "
            f"and {image.GetNumberOfComponentsPerPixel()} values"
        )
    return name, image


def _check_whole(name: str) -> None:
    """ValueError for a NIfTI file that is cut short: ITK would fill the rest with zeros, without a word."""
    if not name.endswith((".nii", ".nii.gz")):
        return
    content = Path(name).read_bytes()
    if name.endswith(".gz"):
        try:
            content = gzip.decompress(content)
        except (EOFError, OSError, zlib.error) as error:
            raise ValueError(f"{name}: the compressed data is cut short or damaged ({error})") from error
    if len(content) < 348:
        raise ValueError(f"{name}: the file is too short for a NIfTI header")
    order = "<" if content[:4] == b"\x5c\x01\x00\x00" else ">"  # sizeof_hdr = 348
    if struct.unpack(order + "i", content[:4])[0] != 348:
        return  # NIfTI-2 or no NIfTI: ITK judges
    sizes = struct.unpack(order + "8h", content[40:56])
    (bits,) = struct.unpack(order + "h", content[72:74])
    (offset,) = struct.unpack(order + "f", content[108:112])
    wanted = int(offset) + math.prod(sizes[1 : sizes[0] + 1]) * bits // 8
    if len(content) < wanted:
        raise ValueError(f"{name}: the file is cut short: {len(content)} bytes of {wanted}")
