"""Viewpoints, the two eyes of a stereo pair, and the approach of a trace to the bone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone
from burrlab.bone.image import checked_point
from burrlab.bone.specimen import unit_vector
from burrlab.common.check import refuse
from burrlab.session.player import Player, RecordingPlayer

_ANGLE = 30.0  # of the view, top to bottom [degree]
_TILT = 28.0  # between approach and line of sight [degree]
_DOWN = (0.0, 0.0, -1.0)
_VIEWER = 500.0  # distance of the viewer for whom the separation of the eyes is given [mm]


@dataclass(frozen=True)
class Viewpoint:
    """A camera: position, focus, up direction [mm], and angle from bottom to top [degree]."""

    position: tuple[float, ...]
    focus: tuple[float, ...]
    up: tuple[float, ...]
    angle: float = _ANGLE

    @property
    def distance(self) -> float:
        """Distance from camera to focus [mm]."""
        return float(np.linalg.norm(np.subtract(self.position, self.focus)))


def surgeon_view(
    bone: VoxelBone,
    entry: ArrayLike | None = None,
    axis: ArrayLike | None = None,
    *,
    width: float | None = None,
    tilt: float = _TILT,
) -> Viewpoint:
    """A surgeon's view: at the entry, along the axis of the approach, tilted to show depth.

    Parameters
    ----------
    bone : VoxelBone
    entry : (x, y, z), optional
        Point looked at [mm]; default: the middle of the volume's face where the axis enters.
    axis : (x, y, z), optional
        Direction of the approach, into the bone; default: downwards, (0, 0, -1). Up in the view is z, or y
        where the approach is along z.
    width : float, optional
        Height of the view at the entry, and its width if it is square [mm]; default: the whole volume.
    tilt : float
        Angle between approach and line of sight [degree].

    Raises
    ------
    ValueError
        If the axis is zero, the entry is farther away than the bone is wide, or a value is not finite.

    Examples
    --------
    >>> import burrlab
    >>> surgeon_view(burrlab.VoxelBone.block((4, 4, 4), 0.1), (2.0, 2.0, 4.0), (0.0, 0.0, -1.0), tilt=0.0).focus
    (2.0, 2.0, 4.0)
    """
    into = unit_vector(_DOWN if axis is None else axis)
    spacing, shape = np.array(bone.spacing), np.array(bone.shape[::-1])
    half = spacing * shape / 2
    middle = np.array(bone.origin) - spacing / 2 + half
    if entry is None:
        focus = (
            middle - (0.35 if width is None else 1.0) * into * (half / np.maximum(np.abs(into), 1e-9)).min()
        )
    else:
        focus = checked_point(entry, "entry")
        beyond = float(np.linalg.norm(np.maximum(np.abs(focus - middle) - half, 0)))
        refuse(
            beyond > 2 * np.linalg.norm(half),
            f"entry lies {beyond:.0f} mm outside the bone, more than it is wide",
        )
    return looking_at(focus, into, 2.15 * float(np.linalg.norm(half)) if width is None else width, tilt)


def looking_at(focus: ArrayLike, axis: ArrayLike | None, width: float, tilt: float = _TILT) -> Viewpoint:
    """The view of `surgeon_view` at a point that may lie far from the bone, as a lifted burr does."""
    into = unit_vector(_DOWN if axis is None else axis)
    refuse(
        not (np.isfinite(width) and width > 0 and np.isfinite(tilt)),
        f"width must be positive and tilt finite, got {width} and {tilt}",
    )
    side = np.eye(3)[2] if abs(into[2]) < 0.9 else np.eye(3)[1]
    up = unit_vector(side - into * (side @ into))
    lean = np.deg2rad(tilt)
    sight = np.cos(lean) * into + np.sin(lean) * up
    distance = width / (2 * np.tan(np.deg2rad(_ANGLE) / 2))
    at = np.asarray(focus, float)
    return Viewpoint(tuple((at - distance * sight).tolist()), tuple(at.tolist()), tuple(up.tolist()))


def eyes(view: Viewpoint, separation: float, aspect: float) -> list[tuple[Viewpoint, float]]:
    """Left and right eye: viewpoint, and the shift of its picture in half widths (VTK's window centre).

    Parameters
    ----------
    view : Viewpoint
        Between the eyes.
    separation : float
        Distance of the eyes for a viewer at 500 mm [mm].
    aspect : float
        Width over height of the picture.
    """
    sight = unit_vector(np.subtract(view.focus, view.position))
    right = unit_vector(np.cross(sight, view.up))
    half = 0.5 * separation * view.distance / _VIEWER
    half_width = view.distance * np.tan(np.deg2rad(view.angle) / 2) * aspect
    return [
        (
            Viewpoint(
                tuple((view.position + way * right).tolist()),
                tuple((view.focus + way * right).tolist()),
                view.up,
                view.angle,
            ),
            -way / half_width,
        )
        for way in (-half, half)
    ]


#: Time after first contact in which the force is along the normal; later the burr cuts sideways too [ms].
_MEETING = 250.0
UNKNOWN_RADIUS = 2.0  # gives a view its width where no radius is recorded [mm]


@dataclass(frozen=True, eq=False)
class Approach:
    """The middle of the contacts [mm], the direction of approach, and a width that holds them all [mm]."""

    entry: NDArray[np.float64]
    axis: NDArray[np.float64]
    width: float


def trace_approach(player: Player) -> Approach | None:
    """The approach of all burrs of a trace, along the first forces on them; None if none touched bone.

    Of a recording, the way from the burr to the first voxels that it removed.
    """
    if isinstance(player, RecordingPlayer):
        when, centers, ways = player.removals()
        first = -ways[when <= when[:1] + _MEETING / 1000.0]
    else:
        burr = player.trace.ticks["burr"]
        touched = burr["touching"] > 0
        centers, forces = burr["center_mm"][touched], burr["force_N"][touched]
        first = forces[: max(round(_MEETING / player.trace.period), 1)]
    if not len(centers):
        return None
    push = -first.sum(axis=0)
    if not np.linalg.norm(push) >= 1e-6 * max(np.linalg.norm(first, axis=1).sum(), 1e-12):  # or not known
        push = np.array(_DOWN)
    low, high = centers.min(axis=0), centers.max(axis=0)
    radius = float(np.nan_to_num(player.burrs.radii.max(), nan=UNKNOWN_RADIUS))
    return Approach(
        (low + high) / 2,
        push / np.linalg.norm(push),
        width=1.6 * float(np.linalg.norm(high - low)) + 7 * radius,
    )


def approach_view(bone: VoxelBone, approach: Approach | None, *, width: float | None = None) -> Viewpoint:
    """A surgeon's view along an approach; without one, of the whole volume from above. `width` [mm] replaces
    the approach's."""
    if approach is None:
        return surgeon_view(bone, width=width)
    return looking_at(approach.entry, approach.axis, approach.width if width is None else width)
