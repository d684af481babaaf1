"""Writing volumes and labels: NRRD, NIfTI, MetaImage."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from burrlab.files import check_folder
from burrlab.volume.header import plain_name
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.segments import segment_fields
from burrlab.volume.volume import Volume

_ENDINGS = (".nrrd", ".nii", ".nii.gz", ".mha")


def write_volume(
    path: str | os.PathLike[str], volume: Volume | LabelVolume, *, compress: bool = True
) -> None:
    """Writes a volume or labels with their geometry; a file of that name is replaced once the new one is whole.

    Parameters
    ----------
    path : path
        Its ending says the format: .nrrd, .nii, .nii.gz, .mha.
    volume : Volume or LabelVolume
    compress : bool
        The values of .nrrd and .mha; the endings of NIfTI say it themselves.

    Raises
    ------
    ValueError
        If the ending is another, or the format cannot hold the values.
    ImportError
        Without SimpleITK (extra `medical`).
    OSError
        If the file cannot be written.

    Notes
    -----
    NIfTI keeps geometry in float32, so spacing, origin and direction come back to 1e-7 of their size. Names and colours of
    labels are written to NRRD, in the fields of a segmentation of 3D Slicer; NIfTI and MetaImage have no place for them, and label
    0 is none of its segments.
    """
    target = Path(path)
    ending = next(
        (e for e in sorted(_ENDINGS, key=len, reverse=True) if target.name.lower().endswith(e)), None
    )
    if ending is None:
        raise ValueError(f"path must end in one of {', '.join(_ENDINGS)}, got {os.fspath(path)}")
    try:
        import SimpleITK as sitk
    except ImportError as error:
        raise ImportError("writing volumes needs SimpleITK: pip install 'burrlab[medical]'") from error
    plain_name(str(target))
    check_folder(target)
    values = volume.values if isinstance(volume, Volume) else volume.labels
    part = target.with_name(f".{target.name}.part{ending}")
    try:
        image = sitk.GetImageFromArray(np.ascontiguousarray(values))
        image.SetSpacing(volume.spacing.tolist())
        image.SetOrigin(volume.origin.tolist())
        image.SetDirection(volume.direction.ravel().tolist())
        if ending == ".nrrd" and isinstance(volume, LabelVolume):
            for key, text in segment_fields(volume.labels, volume.names, volume.colours).items():
                image.SetMetaData(key, text)
        sitk.WriteImage(image, str(part), useCompression=compress and not ending.startswith(".nii"))
        with part.open("rb") as written:
            os.fsync(written.fileno())
        part.replace(target)
    except (RuntimeError, TypeError, KeyError) as error:
        raise ValueError(
            f"{os.fspath(path)}: values of {values.dtype} cannot be written as {ending}"
        ) from error
    finally:
        part.unlink(missing_ok=True)
