"""The watch of a session: critical structures, distance fields, and the limits for events."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from burrlab._core import AnatomyWatch, StructureDistance, StructureSearch, VoxelBone
from burrlab.common.check import real, refuse, scalar
from burrlab.common.progress import Progress, reporter
from burrlab.common.study import cores

SPACING = 0.4  # of the nodes [mm]
MARGIN = 15.0  # about the structure [mm]


def structure_distances(
    bone: VoxelBone, tissues: Sequence[int], progress: Progress | None = None
) -> list[StructureDistance]:
    """Distance fields of structures, one each.

    Parameters
    ----------
    bone : VoxelBone
        With tissues.
    tissues : sequence of int
        Tissue numbers.
    progress : callable or True, optional
        Called with the fraction done, 0 to 1, after each; True shows a bar.

    Raises
    ------
    ValueError
        If the bone has no tissues, a number is not of a tissue, or no voxel carries it.

    Notes
    -----
    Nodes lie 0.4 mm apart and reach 15 mm beyond the box around the structure. A node near a voxel of the
    structure is marked. The Euclidean distance transform of the marks errs by at most half a diagonal of the
    nodes' cell plus half a diagonal of a voxel. For nodes that may be nearer than 8 mm, a search among the
    voxels then gives the exact distance.
    """
    report = reporter(progress, "distances")
    searches = [StructureSearch(bone, tissue) for tissue in tissues]
    numbers = bone.tissue_numbers
    assert numbers is not None  # a search would have refused
    pool = ThreadPoolExecutor(cores())
    try:
        fields = [
            pool.submit(_field, search, bone, numbers, tissue)
            for search, tissue in zip(searches, tissues, strict=True)
        ]
        for done, _ in enumerate(as_completed(fields), 1):
            report(done / len(fields))
        return [field.result() for field in fields]
    finally:  # Ctrl-C ends the fields that have not begun
        pool.shutdown(wait=False, cancel_futures=True)


def _field(
    search: StructureSearch, bone: VoxelBone, numbers: NDArray[np.uint8], tissue: int
) -> StructureDistance:
    begin, end = (
        np.rint((np.asarray(edge) - bone.origin) / bone.spacing + 0.5).astype(int)[::-1]
        for edge in (search.low, search.high)
    )
    box = tuple(slice(first, last) for first, last in zip(begin, end, strict=True))
    mask = numbers[box] == tissue
    low, high = np.asarray(search.low) - MARGIN, np.asarray(search.high) + MARGIN
    count = np.ceil((high - low) / SPACING).astype(int) + 1
    nodes = []  # by axis (z, y, x): the nodes that have voxels
    for axis in range(3):
        xyz = 2 - axis
        voxels = bone.origin[xyz] + np.arange(box[axis].start, box[axis].stop) * bone.spacing[xyz]
        nearest = np.rint((voxels - low[xyz]) / SPACING).astype(int)
        starts = np.flatnonzero(np.diff(nearest, prepend=-1))
        mask = np.logical_or.reduceat(mask, starts, axis=axis)
        nodes.append(nearest[starts])
    empty = np.ones(count[::-1], bool)
    empty[np.ix_(*nodes)] = ~mask
    error = float(np.sqrt(3) / 2 * SPACING + np.linalg.norm(bone.spacing) / 2 + 1e-4)  # rounded to float32
    return StructureDistance(search, _estimate(empty), SPACING, low, error)


def _estimate(empty: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance of each node to the nearest that is not empty [mm]; slice by slice, to save memory."""
    nearest = scipy.ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    estimate = np.empty(empty.shape, np.float32)
    y, x = np.ogrid[: empty.shape[1], : empty.shape[2]]
    for z in range(len(estimate)):
        squared = (nearest[0, z] - z) ** 2 + (nearest[1, z] - y) ** 2 + (nearest[2, z] - x) ** 2
        np.sqrt(squared, out=estimate[z], casting="unsafe")
    estimate *= np.float32(SPACING)
    return estimate


#: One number for all structures, or one a structure by name.
Limit = float | Mapping[str, float]

_APPROACH, _TOUCH, _INJURY, _HYSTERESIS = 2.0, 0.0, 0.0, 0.5  # ours


@dataclass(frozen=True)
class Limits:
    """Limits for events at a structure: distances of the burr's surface [mm], volume removed [mm^3]."""

    approach: float
    touch: float
    injury: float


class Watch:
    """Critical structures of a bone, with distance fields, for `Session(..., watch=...)`.

    Parameters
    ----------
    bone : VoxelBone
        With tissues: the session's, or the bone that it was copied from.
    approach, touch : float or {name: float}
        Distances of the burr's surface to the segmented structure at which an approach and a touch are told
        [mm]. A structure without an entry has the default: 2 and 0 mm, ours.
    injury : float or {name: float}
        Volume removed from the structure above which an injury is told [mm^3]; default 0, the first level.
    hysteresis : float
        Distance beyond a limit that the burr must reach before an event is told again [mm]; default ours.
    structures : sequence of str, optional
        Names of tissues; default: all that are critical and have voxels.
    progress : callable or True, optional
        Called with the fraction of the fields that is done, 0 to 1; True shows a bar.

    Attributes
    ----------
    structures : tuple of str
    limits : tuple of Limits
        One a structure.

    Raises
    ------
    ValueError
        If the bone has no tissues or no critical one, a name is not a tissue's, a structure has no voxel, or
        the limits are out of order: 0 <= touch <= approach, approach + hysteresis + radius at most 15 mm.

    Notes
    -----
    A structure is all voxels with its label, as boxes, whatever bone was or is in them. `docs/anatomy.md` has
    the definitions and the errors.

    Examples
    --------
    >>> import numpy as np
    >>> from burrlab import Tissue, Tissues, VoxelBone, materials
    >>> bone = VoxelBone.block((8, 8, 8), 0.2)
    >>> numbers = np.zeros(bone.shape, np.uint8)
    >>> numbers[:, :, 30:] = 1
    >>> rows = [Tissue(name, label=i, c_e=2.0, alpha=0.1, critical=i == 1) for i, name in enumerate(("bone", "nerve"))]
    >>> bone.set_tissues(Tissues(rows, materials["bone"]), numbers)
    >>> watch = Watch(bone, approach=1.0)
    >>> watch.structures, round(float(watch.distance((3.9, 4.0, 4.0), "nerve", radius=1.0)), 9)
    (('nerve',), 1.0)
    """

    def __init__(
        self,
        bone: VoxelBone,
        *,
        approach: Limit = _APPROACH,
        touch: Limit = _TOUCH,
        injury: Limit = _INJURY,
        hysteresis: float = _HYSTERESIS,
        structures: Sequence[str] | None = None,
        progress: Progress | None = None,
    ) -> None:
        tissues = bone.tissues
        if tissues is None:
            raise ValueError("bone must have tissues, got one of a single material")
        if structures is None:
            structures = critical_structures(bone)
            refuse(
                not structures, "structures must be named: no tissue of the bone is critical and has voxels"
            )
        self.structures = tuple([structures] if isinstance(structures, str) else structures)
        refuse(
            len(set(self.structures)) < len(self.structures),
            f"structures must differ, got {', '.join(self.structures)}",
        )
        numbers = [tissues.number(name) for name in self.structures]
        for name, limit in (("approach", approach), ("touch", touch), ("injury", injury)):
            for key in limit if isinstance(limit, Mapping) else ():
                refuse(
                    key not in self.structures, f"{name} must be of watched structures, got one of '{key}'"
                )
        self.limits = tuple(
            Limits(_of(approach, name, _APPROACH), _of(touch, name, _TOUCH), _of(injury, name, _INJURY))
            for name in self.structures
        )
        self.hysteresis = scalar(hysteresis, "hysteresis")
        self.colours = tuple(tissues[number].colour for number in numbers)
        self._voxel_volume = float(np.prod(bone.spacing))
        self._distances = structure_distances(bone, numbers, progress)
        self.core([1.0])  # the limits are checked there

    @classmethod
    def of_settings(cls, bone: VoxelBone, settings: Mapping[str, Any], **other: Any) -> "Watch":
        """A watch with these settings, but for `other` parameters, on an equal bone. ValueError, KeyError or
        TypeError if invalid."""
        recorded = {row["name"]: row for row in settings["structures"]}
        names = other.get("structures", [row["name"] for row in settings["structures"]])
        limits: dict[str, Any] = {
            limit: {name: recorded[name][f"{limit}_{unit}"] for name in names if name in recorded}
            for limit, unit in (("approach", "mm"), ("touch", "mm"), ("injury", "mm3"))
        }
        return cls(bone, **{"hysteresis": settings["hysteresis_mm"], "structures": names, **limits, **other})

    @property
    def settings(self) -> dict[str, Any]:
        """The settings for JSON, units in the names."""
        return {
            "structures": [
                {"name": name, "approach_mm": limit.approach, "touch_mm": limit.touch, "injury_mm3": limit.injury}
                for name, limit in zip(self.structures, self.limits, strict=True)
            ],
            "hysteresis_mm": self.hysteresis, "field_spacing_mm": SPACING, "field_margin_mm": MARGIN,
            "voxel_volume_mm3": self._voxel_volume,
        }  # fmt: skip

    def core(self, radii: Sequence[float]) -> AnatomyWatch:
        """A new watch of the core for burrs of these radii [mm]. ValueError if limits are out of order."""
        rows = [
            (distance, limit.approach, limit.touch, limit.injury, self.hysteresis)
            for distance, limit in zip(self._distances, self.limits, strict=True)
        ]
        return AnatomyWatch(rows, [float(radius) for radius in radii])

    def distance(self, centers: ArrayLike, structure: str, *, radius: float = 0.0) -> NDArray[np.float64]:
        """Distance of the surface of a sphere to a structure, as in events.

        Parameters
        ----------
        centers : array_like, shape (..., 3)
            Bone frame [mm].
        structure : str
        radius : float
            0 to 6 [mm].

        Returns
        -------
        ndarray, shape (...)
            [mm], at least -radius; infinite beyond the structure's field.

        Raises
        ------
        ValueError
            If the structure is not watched, or a number is not finite or out of range.
        """
        check_structure(structure, self.structures)
        at = real(centers, "centers")
        return self._distances[self.structures.index(structure)].of_sphere(at, scalar(radius, "radius"))

    def __repr__(self) -> str:
        limits = ", ".join(
            f"{n} {asdict(limit)}" for n, limit in zip(self.structures, self.limits, strict=True)
        )
        return f"Watch({limits}, hysteresis={self.hysteresis:g})"


def check_structure(structure: str, structures: Sequence[str]) -> None:
    """ValueError unless the structure is watched."""
    refuse(
        structure not in structures, f"structure must be one of {', '.join(structures)}, got '{structure}'"
    )


def critical_structures(bone: VoxelBone) -> list[str]:
    """Names of the critical tissues that have voxels."""
    numbers = np.asarray(bone.tissue_numbers)
    return [t.name for i, t in enumerate(bone.tissues or ()) if t.critical and (numbers == i).any()]


def _of(limit: Limit, name: str, default: float) -> float:
    return scalar(limit.get(name, default) if isinstance(limit, Mapping) else limit, "a limit")
