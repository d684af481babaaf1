"""A scripted mastoidectomy: the burr's path through a planned cavity, layer by layer."""

import math
from dataclasses import dataclass, field

import numpy as np
import scipy
from contourpy import contour_generator
from numpy.typing import ArrayLike, NDArray

from burrlab._core import Burr, ScriptedDevice
from burrlab.bone.phantom.phantom import Phantom
from burrlab.common.check import refuse
from burrlab.common.progress import doing, stoppable
from burrlab.common.table import by_value

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Least size of the voxels on which a path is planned [burr radii].
COARSE = 0.1
#: Ratio of the speed between cuts to that in a cut, and lift off the bone between cuts [mm]; ours.
RAPID, LIFT = 3.0, 1.0


@by_value
@dataclass(frozen=True)
class BurrPath:
    """The burr's centre over time, and whether the burr turns.

    Attributes
    ----------
    time : ndarray, shape (n,)
        [s], from 0, increasing.
    center : ndarray, shape (n, 3)
        (x, y, z) in the bone frame [mm], linear in time between rows.
    on : ndarray of bool, shape (n,)
        Whether the burr turns from this row to the next.
    layers : int
    """

    time: Floats = field(repr=False)
    center: Floats = field(repr=False)
    on: Mask = field(repr=False)
    layers: int

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.time[-1])

    def device(self) -> ScriptedDevice:
        """A device that follows the path in a session."""
        return ScriptedDevice(self.time, self.center, self.on)


@doing("planning a path")
def mastoidectomy_path(
    phantom: Phantom,
    burr: Burr,
    *,
    layer: float | None = None,
    step: float | None = None,
    speed: float = 20.0,
    depth: float | None = None,
) -> BurrPath:
    """A burr's path through the planned cavity of a phantom, in layers from the surface down.

    A layer has parallel strokes, and then one round along its edge.

    Parameters
    ----------
    phantom : Phantom
    burr : Burr
    layer : float, optional
        Distance between layers [mm]; default: a quarter of the radius. Each layer lies on the nearest plane of the
        planning's voxels, whose sides are the phantom's, or several of these up to 0.1 radii. No plane is cut
        twice.
    step : float, optional
        Distance between strokes of a layer [mm]; default: half the radius.
    speed : float
        Speed in a cut [mm/s].
    depth : float, optional
        Last depth of the burr's tip below the spine of Henle [mm]; default: the whole cavity.

    Returns
    -------
    BurrPath
        The burr never turns where it would touch bone outside the planned cavity, to within a voxel. So it
        leaves corners that are sharper than itself.

    Raises
    ------
    ValueError
        If layer, step, speed or depth is not positive, or the burr fits nowhere into the cavity.

    Notes
    -----
    The burr is taken to go where it is sent, whatever the force. A spring between device and burr, or a
    slower burr, removes less. Layers, strokes and speed are ours.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.anatomy import mastoidectomy_path, temporal_bone
    >>> phantom = temporal_bone(0.4, seed=1)
    >>> mastoidectomy_path(phantom, burrlab.Burr(3.0), layer=3.0, step=2.0)
    BurrPath(layers=5)
    """
    layer = burr.radius / 4 if layer is None else layer
    step = burr.radius / 2 if step is None else step
    for name, value in (("layer", layer), ("step", step), ("speed", speed), ("depth", depth)):
        refuse(value is not None and not 0 < value < math.inf, f"{name} must be positive, got {value}")
    plan = _Plan(phantom, burr.radius)
    rows: list[tuple[Floats, bool]] = []
    layers = 0
    layer = max(layer, plan.spacing[0] / 100)  # thinner ones come to the same planes
    depths = np.arange(plan.first + layer - burr.radius, plan.deepest, layer)
    depths = depths[depths + burr.radius <= (math.inf if depth is None else depth)]
    for plane in np.unique(np.rint((depths - plan.origin[0]) / plan.spacing[0]).astype(int)):
        strokes = plan.strokes(plane, step)
        layers += bool(strokes)
        for stroke in strokes:
            rows += plan.approach(rows[-1][0] if rows else None, stroke[0])
            rows += [(place, True) for place in stroke]
    refuse(not rows, f"burr of {burr.radius:g} mm fits nowhere into the planned cavity")
    center, on = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    length = np.linalg.norm(np.diff(center, axis=0), axis=1)
    # ScriptedDevice needs increasing times, even where a point comes twice.
    durations = np.maximum(length / np.where(on[:-1], speed, RAPID * speed), 1e-3)
    on[-1] = False
    return BurrPath(np.append(0.0, np.cumsum(durations)), center * [plan.sign, 1.0, 1.0], on, layers)


class _Plan:
    """Allowed places of the burr's centre, in a frame whose x grows with depth."""

    def __init__(self, phantom: Phantom, radius: float) -> None:
        self.radius, self.sign = radius, 1 if phantom.side == "right" else -1
        spacing = np.array(phantom.bone.spacing)
        thin = [max(1, int(COARSE * radius / s)) for s in spacing]
        every = tuple(slice(n // 2, None, n) for n in thin[::-1])
        target = phantom.target[:, :, :: self.sign][every]
        bone = np.asarray(phantom.bone.pristine > 0)[:, :, :: self.sign][every]
        start = np.array(phantom.bone.origin)
        if self.sign < 0:
            start[0] = -(start[0] + spacing[0] * (phantom.bone.shape[2] - 1))
        self.origin = start + spacing * [n // 2 for n in thin]
        self.spacing = spacing * thin
        refuse(not target.any(), "phantom must hold some of the planned cavity, got a box with none of it")
        # The burr needs room beside and above the bone too.
        pad = math.ceil(2.0 * radius / self.spacing[0]) + 2
        target, bone = (np.pad(a, ((0, 0), (0, 0), (pad, 0))) for a in (target, bone))
        self.origin[0] -= pad * self.spacing[0]

        def distance(mask: Mask) -> Floats:
            return stoppable(lambda: scipy.ndimage.distance_transform_edt(mask, sampling=self.spacing[::-1]))

        # (z, y, x) of the centre: distance of the burr's surface to what must not be cut [mm]
        free = target | ~np.logical_or.accumulate(target | bone, axis=2)  # in the cavity, or above the bone
        self.room = distance(np.pad(free, 1))[1:-1, 1:-1, 1:-1] - radius
        # where the centre may be and the burr reaches planned bone
        self.cuts = (distance(~(target & bone)) < radius) & (self.room > 0)
        edge = self.origin[0] + self.spacing[0] * np.flatnonzero(target.any(axis=(0, 1)))
        self.first, self.deepest = float(edge[0]), float(edge[-1])  # x between which the planned cavity lies

    def strokes(self, k: int, step: float) -> list[Floats]:
        """Polylines (n, 3) along which the burr cuts in plane k: to and fro along y, then around."""
        if not 0 <= k < self.room.shape[2] or not self.cuts[:, :, k].any():
            return []
        out: list[Floats] = []
        z_step, forward = max(1, round(step / self.spacing[2])), True
        for row in range(z_step // 2, self.room.shape[0], z_step):
            runs = [self._places(k, [(row, a), (row, b - 1)]) for a, b in _runs(self.cuts[row, :, k])]
            out += runs if forward else [run[::-1] for run in runs[::-1]]
            forward = not forward if runs else forward
        for line in contour_generator(z=self.room[:, :, k]).lines(0.0):
            at = np.asarray(line)[:, ::-1]  # (z, y), as indices
            cut = scipy.ndimage.binary_dilation(self.cuts[:, :, k])[tuple(np.rint(at).astype(int).T)]
            out += [self._places(k, at[a:b]) for a, b in _runs(cut)]
        return out

    def _places(self, k: int, at: ArrayLike) -> Floats:
        z, y = np.asarray(at, dtype=float).T
        return np.asarray(self.origin + self.spacing * np.column_stack([np.full(len(z), k), y, z]))

    def approach(self, here: Floats | None, goal: Floats) -> list[tuple[Floats, bool]]:
        """Rows that bring the burr to a stroke: straight if the way is clear, else lifted and not turning."""
        top = self.first - self.radius - LIFT
        over = np.array([top, goal[1], goal[2]]), False
        if here is None:
            return [over]
        count = int(np.max(np.abs(goal - here) / self.spacing)) + 2
        way = here + np.linspace(0.0, 1.0, count)[:, None] * (goal - here)
        at = np.rint((way - self.origin) / self.spacing).astype(int)
        x, y, z = np.clip(at, 0, np.array(self.room.shape[::-1]) - 1).T
        if (self.room[z, y, x] > 0).all():
            return [(here, True)]
        return [(here, False), (np.array([top, here[1], here[2]]), False), over]


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """Begin and end of each run of at least two true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1]
