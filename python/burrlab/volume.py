"""Grey volumes from files: NRRD, NIfTI and MetaImage, through SimpleITK (extra `medical`)."""

from __future__ import annotations

import gzip
import math
import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone
from burrlab.specimen import Specimen, Vector, surface_along, unit_vector


@dataclass(frozen=True)
class Volume:
    """Grey values on a grid, placed in the volume's own coordinates.

    Attributes
    ----------
    values : ndarray, shape (nz, ny, nx)
    spacing : ndarray, shape (3,)
        Along the voxel axes x, y, z [mm].
    origin : ndarray, shape (3,)
        Centre of voxel (0, 0, 0) in the volume's own coordinates [mm].
    direction : ndarray, shape (3, 3)
        Columns are the voxel axes in the volume's own coordinates; orthonormal.
    path : str
    """

    values: NDArray[Any]
    spacing: NDArray[np.float64]
    origin: NDArray[np.float64]
    direction: NDArray[np.float64]
    path: str

    def bone_point(self, point: Vector) -> NDArray[np.float64]:
        """A point of the volume's own coordinates in the bone frame (voxel axes) [mm]."""
        return np.asarray(self.direction.T @ np.asarray(point, dtype=float))

    def to_bone(self, empty: float, solid: float) -> VoxelBone:
        """Occupancy by a two-point map: grey value `empty` and below is 0, `solid` and above is 255.

        Raises
        ------
        ValueError
            If the values are not finite, or `empty` is not below `solid`.
        """
        if not (np.isfinite(empty) and np.isfinite(solid) and empty < solid):
            raise ValueError(f"map must be LO:HI with LO below HI, got {empty:g}:{solid:g}")
        levels = np.clip((self.values.astype(np.float64) - empty) / (solid - empty), 0.0, 1.0)
        if not np.all(np.isfinite(levels)):
            raise ValueError(f"{self.path}: the volume holds values that are not finite")
        return VoxelBone(
            np.rint(255 * levels).astype(np.uint8), spacing=self.spacing, origin=self.bone_point(self.origin)
        )

    def specimen(self, empty: float, solid: float, *, entry: Vector, axis: Vector) -> Specimen:
        """The bone with an axis; immersion counts from the axis' first crossing of occupancy 128.

        Parameters
        ----------
        empty, solid : float
            As for `to_bone`.
        entry : (x, y, z)
            Where the axis begins, in the volume's own coordinates [mm].
        axis : (x, y, z)
            Direction into the bone, in the volume's own coordinates.

        Raises
        ------
        ValueError
            If the axis meets no bone, or the entry lies inside bone.
        """
        bone = self.to_bone(empty, solid)
        direction = np.asarray(self.direction.T @ unit_vector(axis))
        start = self.bone_point(entry)
        surface = surface_along(bone, start, direction)
        if surface is None:
            raise ValueError(
                f"entry: the axis from {tuple(map(float, entry))} meets no occupancy of 128 in {self.path}, "
                f"whose grey values are {self.values.min():g} to {self.values.max():g}"
            )
        if np.array_equal(surface, start):
            raise ValueError(f"entry: {tuple(map(float, entry))} lies inside bone; begin outside it")
        where = f"{self.path}, map {empty:g}:{solid:g}, entry {tuple(map(float, entry))}, axis {tuple(map(float, axis))}"
        return Specimen(bone, surface, direction, where)


def read_volume(path: str | os.PathLike[str]) -> Volume:
    """Reads a grey volume: NRRD, NIfTI, MetaImage.

    Parameters
    ----------
    path : path

    Returns
    -------
    Volume

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ImportError
        Without SimpleITK (extra `medical`).
    ValueError
        If the file cannot be read whole, is not a three-dimensional volume of one value a voxel, or its
        direction matrix is not orthonormal.
    """
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
    direction = np.array(image.GetDirection()).reshape(3, 3)
    if not np.allclose(direction.T @ direction, np.eye(3), atol=1e-4):
        raise ValueError(
            f"{name}: the direction matrix is not orthonormal (sheared volumes are not supported)"
        )
    return Volume(
        values=sitk.GetArrayFromImage(image),
        spacing=np.array(image.GetSpacing()),
        origin=np.array(image.GetOrigin()),
        direction=direction,
        path=name,
    )


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
