"""Comparison of the removed bone with a target, by tissue."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from burrlab._core import VoxelBone
from burrlab.bone.image import LabelVolume, check_same_geometry, grid_of_bone
from burrlab.bone.tissues import check_count, label_counts
from burrlab.common.check import amend_error, refuse
from burrlab.common.figures import Axes, axes_or_new, drawing
from burrlab.common.progress import doing
from burrlab.common.records import AsDict, Codec
from burrlab.common.table import by_value, html_table

#: Voxels read at a time, to bound the memory.
AT_A_TIME = 4_000_000
_PARTS = ("overlap", "missed", "excess")
_COLOURS = ("#009E73", "#E69F00", "#D55E00")


@by_value
@dataclass(frozen=True, repr=False)
class TargetComparison(AsDict):
    """Bone removed inside and outside a region, by tissue. Made by `compare_with_target`.

    Attributes
    ----------
    tissues : tuple of str
        Tissues in the region or removed; "bone" if the bone has no tissues.
    overlap : ndarray
        Removed inside the region, by tissue [mm^3 of solid bone], as `VoxelBone.removed`.
    missed : ndarray
        Left inside [mm^3].
    excess : ndarray
        Removed outside [mm^3].
    volume : float
        Volume of the region, whatever is in it [mm^3].
    """

    tissues: tuple[str, ...]
    overlap: NDArray[np.float64]
    missed: NDArray[np.float64]
    excess: NDArray[np.float64]
    volume: float

    @property
    def planned(self) -> float:
        """Bone in the region at the beginning [mm^3]."""
        return float(self.overlap.sum() + self.missed.sum())

    @property
    def removed(self) -> float:
        """Bone removed, inside and outside [mm^3]."""
        return float(self.overlap.sum() + self.excess.sum())

    @property
    def percent(self) -> float:
        """Part of the planned bone that was removed [%]."""
        return 100.0 * float(self.overlap.sum()) / self.planned

    @property
    def dice(self) -> float:
        """2 overlap/(planned + removed), 0..1 (Dice, Ecology 1945)."""
        return 2.0 * float(self.overlap.sum()) / (self.planned + self.removed)

    def table(self) -> str:
        """Text, a line a tissue."""
        wide = max(8, *(len(name) for name in self.tissues))
        rows = [
            *zip(self.tissues, self.overlap, self.missed, self.excess, strict=True),
            ("all", self.overlap.sum(), self.missed.sum(), self.excess.sum()),
        ]
        return "\n".join([
            f"{'tissue':<{wide}}  overlap [mm^3]  missed [mm^3]  excess [mm^3]",
            *(f"{name:<{wide}}  {a:>14.2f}  {b:>13.2f}  {c:>13.2f}" for name, a, b, c in rows),
            f"{self.percent:.1f} % of the target's {self.planned:.1f} mm^3 of bone removed; Dice {self.dice:.3f}",
        ])  # fmt: skip

    __repr__ = table

    def _repr_html_(self) -> str:
        volumes = {f"{part} [mm³]": getattr(self, part).tolist() for part in _PARTS}
        title = f"{self.percent:.1f} % of the target's {self.planned:.1f} mm³ removed; Dice {self.dice:.3f}"
        return html_table(title, {"tissue": self.tissues, **volumes})

    @drawing
    def plot(
        self, ax: Axes | None = None, *, label: str | None = None, color: Any = None, **style: Any
    ) -> Axes:
        """Bars of the three volumes, a row a tissue.

        `label` is said before each part, `color` fades from part to part, `style` is that of the bars.
        """
        axes = axes_or_new(ax)
        rows = np.arange(len(self.tissues))
        for k, (part, colour) in enumerate(zip(_PARTS, _COLOURS, strict=True)):
            look = {"color": colour if color is None else to_rgba(color, 1 - 0.35 * k), **style}
            name = f"{label}, {part}" if label else part
            bars = axes.barh(rows + 0.27 * (k - 1), getattr(self, part), 0.25, label=name, **look)
            axes.bar_label(bars, fmt=lambda v: f"{v:.1f}" if v else "", padding=2, fontsize=8)
        axes.set_yticks(rows, self.tissues)
        axes.invert_yaxis()
        axes.margins(x=0.12)
        title = f"{self.percent:.1f} % of the target removed, Dice {self.dice:.2f}"
        axes.set(xlabel="volume of solid bone [mm$^3$]", title=title)
        return axes


TargetComparison._codec = Codec(
    keys={
        TargetComparison: {
            "target_mm3": "volume", "planned_mm3": "planned", "removed_mm3": "removed",
            "overlap_mm3": lambda comparison: comparison.overlap.sum(), "missed_mm3": lambda comparison: comparison.missed.sum(),
            "excess_mm3": lambda comparison: comparison.excess.sum(), "percent": "percent", "dice": "dice",
            "tissues": lambda comparison: {
                name: {f"{part}_mm3": getattr(comparison, part)[k] for part in _PARTS} for k, name in enumerate(comparison.tissues)
            },
        }
    }
)  # fmt: skip


@doing("comparing with a target")
def compare_with_target(
    bone: VoxelBone, target: NDArray[Any] | LabelVolume, *, onto: bool = False
) -> TargetComparison:
    """Overlap, missed and excess volume of what was removed from a bone.

    With q the present and p the pristine level of a voxel, in units of 255 levels: overlap = sum of p - q
    over the region, missed = sum of q over the region, excess = sum of p - q over the rest. The sums are
    exact, of whole numbers.

    Parameters
    ----------
    bone : VoxelBone
        The bone after removal; its pristine levels are its state before.
    target : ndarray of bool, shape (z, y, x), or LabelVolume
        The region to remove. In a label volume: all voxels that are not 0, on the bone's own grid.
    onto : bool
        Bring a label volume onto the bone's voxels first, as `LabelVolume.on` does: a plan drawn in a CT with
        coarser voxels, or one that covers a part of the bone. Its axes must be those of the volume that the
        bone was made of.

    Returns
    -------
    TargetComparison

    Raises
    ------
    ValueError
        If the target does not have the bone's shape or grid, is not of bool, has labels below 0 or more than
        64 labels, or holds no bone.

    Examples
    --------
    >>> import numpy as np
    >>> import burrlab
    >>> bone = burrlab.VoxelBone.block((2, 2, 2), 0.5)
    >>> target = np.zeros((4, 4, 4), bool)
    >>> target[2:] = True
    >>> left = bone.density.copy()
    >>> left[3] = 0
    >>> bone.restore(left)
    >>> comparison = compare_with_target(bone, target)
    >>> comparison.percent, float(comparison.missed[0]), round(comparison.dice, 3)
    (50.0, 2.0, 0.667)
    """
    region = _region(bone, target if isinstance(target, LabelVolume) else np.asarray(target), onto)
    names = [tissue.name for tissue in bone.tissues] if bone.tissues is not None else ["bone"]
    numbers = bone.tissue_numbers
    sums = np.zeros((3, len(names)), dtype=np.int64)
    layers = max(1, AT_A_TIME // region[0].size)
    for begin in range(0, len(region), layers):
        rows = slice(begin, begin + layers)
        inside = region[rows]
        now = bone.read((begin, 0, 0), inside.shape).astype(np.int64)
        lost = bone.read((begin, 0, 0), inside.shape, pristine=True) - now
        which = np.zeros(now.shape, np.uint8) if numbers is None else numbers[rows]
        for row, (where, levels) in enumerate(((inside, lost), (inside, now), (~inside, lost))):
            # Weights of bincount are doubles, which hold these sums exactly: at most 255 times 4 million.
            sums[row] += np.bincount(which[where], levels[where], len(names)).astype(np.int64)
    refuse(sums[:2].sum() == 0, "target must hold bone, got a region with none in it")
    volume = float(np.prod(bone.spacing))
    used = [k for k in range(len(names)) if sums[:, k].any()]
    overlap, missed, excess = sums[:, used] * (volume / 255.0)
    return TargetComparison(
        tuple(names[k] for k in used), overlap, missed, excess, int(np.count_nonzero(region)) * volume
    )


def _region(bone: VoxelBone, target: NDArray[Any] | LabelVolume, onto: bool) -> NDArray[np.bool_]:
    if not isinstance(target, LabelVolume):
        refuse(onto, "target must be a LabelVolume to be brought onto the bone's voxels, got an array")
        refuse(target.dtype != np.bool_, f"target must be an array of bool, got {target.dtype}")
        refuse(
            target.shape != bone.shape, f"target must have the bone's shape {bone.shape}, got {target.shape}"
        )
        return target
    check_count(label_counts(target.labels, target.path), f"{target.path}: ")
    grid = grid_of_bone(bone, target)
    labels = target.on(grid) if onto else target
    with amend_error(after="; onto=True (--onto) brings it on the bone's voxels"):
        check_same_geometry(labels, grid)
    return np.asarray(labels.labels != 0)
