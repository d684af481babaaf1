"""Haptic devices: where they stand beside the bone, and what models give, with the source of each number."""

import math
import re
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from burrlab._core import VoxelBone
from burrlab.common.check import check_positive, nearest, refuse, scalar, whole

_UNITS = {
    "peak_force": "N", "continuous_force": "N", "stiffness": "N_per_mm", "damping": "N_s_per_m", "friction": "N",
    "encoder_step": "mm", "rate": "Hz", "workspace": "mm", "window": "s",
}  # fmt: skip


@dataclass(frozen=True)
class DeviceFrame:
    """Where a device stands, so that a small workspace reaches a bone: scale x rotation x device + offset.

    Forces are turned back to the device's axes and not scaled: a scale of 2 doubles the stiffness that the hand
    meets.

    Parameters
    ----------
    scale : float
        Motion of the burr over that of the device.
    rotation : (w, x, y, z)
        Unit quaternion that turns directions of the device into those of the bone.
    offset : (x, y, z)
        Place of the device's origin, bone frame [mm].
    clutch : int, optional
        Number of a button, 0 to 7. While it is held the burr stands still, off and without force, and the device
        moves on; then the burr goes on from where it stood.

    Raises
    ------
    ValueError
        If the scale is not positive, the rotation not of length 1, the offset not finite, or the clutch no button.

    Examples
    --------
    >>> import burrlab
    >>> half = 0.5**0.5
    >>> frame = burrlab.DeviceFrame(scale=0.5, rotation=(half, half, 0, 0), clutch=1)  # y of the device is z here
    """

    scale: float = 1.0
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    clutch: int | None = None

    def __post_init__(self) -> None:
        check_positive("scale", scalar(self.scale, "scale"))
        for name, count in (("rotation", 4), ("offset", 3)):
            numbers = getattr(self, name)
            refuse(
                not isinstance(numbers, Iterable) or isinstance(numbers, str) or len(tuple(numbers)) != count,
                f"{name} must be {count} numbers, got {numbers!r}",
            )
            object.__setattr__(self, name, tuple(scalar(number, name) for number in numbers))
        length = math.hypot(*self.rotation)
        refuse(
            not abs(length * length - 1.0) <= 1e-3,
            f"rotation must be a quaternion of length 1, got {length:g}",
        )
        refuse(not all(map(math.isfinite, self.offset)), f"offset must be finite, got {self.offset}")
        if self.clutch is not None:
            whole("clutch", self.clutch, 8, "8")


def describe_miss(bone: VoxelBone, path: NDArray[np.float64], frame: DeviceFrame, radius: float) -> str:
    """By how much a burr passes a bone, whose device is on a path of shape (n, 3); empty if it meets the bone."""
    solid = np.asarray(bone.density) > 0
    if not solid.any():
        return "it is empty"
    surface = solid & ~scipy.ndimage.binary_erosion(solid)
    voxels = bone.origin + np.argwhere(surface)[:, ::-1] * np.array(bone.spacing)
    turn = scipy.spatial.transform.Rotation.from_quat(np.roll(frame.rotation, -1))
    path = np.asarray(frame.scale * turn.apply(path) + frame.offset)
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    at = np.linspace(0.0, along[-1], 2001)
    places = np.column_stack([np.interp(at, along, axis) for axis in path.T])
    miss = float(np.min(scipy.spatial.KDTree(voxels).query(places)[0])) - radius
    half = np.array(bone.spacing) / 2
    box = ", ".join(
        f"{axis} {low:.1f} to {high:.1f}"
        for axis, low, high in zip("xyz", voxels.min(axis=0) - half, voxels.max(axis=0) + half, strict=True)
    )
    return f"its script missed it by {miss:.2f} mm; the bone's box, in the bone frame: {box} mm" * (miss > 0)


@dataclass(frozen=True)
class DeviceLimits:
    """What a model of a haptic device gives, for `Safety(limits=...)`. None: no public source gives it.

    Parameters
    ----------
    model : str
    peak_force : float, optional
        Largest force [N].
    continuous_force : float, optional
        Force that it gives for as long as one likes [N]. A session keeps the RMS over `window` below it.
    stiffness : float, optional
        Stiffest spring that it renders stably, at 1 kHz [N/mm].
    damping, friction, encoder_step : float, optional
        Of the device without a hand: viscous damping [N s/m], Coulomb friction [N], step of a position [mm].
    rate : float, optional
        Fastest loop [Hz].
    workspace : tuple of float, optional
        Width, height and depth of a box, or the diameter of a sphere [mm].
    window : float
        Time constant of the exponential window of the continuous force [s]. The default is ours: no source
        states one.
    sources : mapping
        {name of a number: its source}

    Raises
    ------
    ValueError
        If a number is neither None nor positive and finite.

    Examples
    --------
    >>> import dataclasses
    >>> from burrlab import device_limits
    >>> touch = device_limits["touch"]
    >>> touch.peak_force, touch.continuous_force, touch.friction
    (3.3, 0.88, None)
    >>> mine = dataclasses.replace(touch, friction=0.2)  # measured by yourself
    """

    model: str
    peak_force: float | None = None
    continuous_force: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    friction: float | None = None
    encoder_step: float | None = None
    rate: float | None = None
    workspace: tuple[float, ...] | None = None
    window: float = 10.0
    sources: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        for name in _UNITS:
            value = getattr(self, name)
            numbers = value if isinstance(value, tuple) else (value,)
            for number in () if value is None and name != "window" else numbers:
                refuse(
                    not isinstance(number, int | float)
                    or isinstance(number, bool)
                    or not 0 < number < math.inf,
                    f"{name} must be positive and finite, or None, got {number!r}",
                )

    def numbers(self) -> dict[str, Any]:
        """The numbers that are known, by name with unit."""
        return {
            f"{name}_{unit}": number
            for name, unit in _UNITS.items()
            if (number := getattr(self, name)) is not None
        }


_SOURCES = {
    "a": "CHAI3D 3.2.0, src/devices/CPhantomDevices.cpp, https://github.com/chai3d/chai3d",
    "b": "the device's answer to HD_NOMINAL_MAX_CONTINUOUS_FORCE, noted in two public programs (a ROS 2 node for the "
         "Geomagic Touch; 'Demo for Force-Feedback of Tactile Testbed')",
    "c": "'3D Systems Touch X', a public note of 9 April 2026 that quotes the data sheets of 3D Systems and SensAble; "
         "these were not read",
    "d": "CHAI3D 3.2.0, src/devices/CDeltaDevices.cpp, by its authors and Force Dimension, "
         "https://github.com/chai3d/chai3d: largest continuous force",
    "e": "H3D API wiki, page Novint_Falcon, 2021, https://github.com/SenseGraphics/h3dapi/wiki/Novint_Falcon: "
         "above 400 dpi, 4 x 4 x 4 inches",
    "f": "Novint Technologies, information of 28 May 2008: motors are updated 1000 times a second",
    "g": "'Specifications' of the Inverse3, a public product page, 2026; 4 N in 80 % of the workspace",
}  # fmt: skip
_COLUMNS = ("peak_force", "continuous_force", "stiffness", "encoder_step", "rate", "workspace")
# A letter is the number's source.
_TABLE = """
touch         3.3a  0.88b  0.4a  0.055c   1000c  160x120x70c
phantom_omni  3.3a  0.88c  0.7a  0.055c   1000c  160x120x70c
touch_x       7.9a  1.75c  1a    0.023c   1000c  160x120x120c
premium_1.5   8.5a  1.4c   0.8a  0.03c    1000c  381x267x191c
premium_3.0   22a   -      1a    -        -      500a
omega.3       12d   12d    5d    -        -      150d
omega.6       12d   12d    5d    -        -      150d
omega.7       12d   12d    5d    -        -      150d
sigma.7       12d   12d    4d    -        -      150d
lambda.7      12d   12d    8d    -        -      225d
delta.3       20d   20d    5d    -        -      300d
falcon        8d    -      3d    0.0635e  1000f  101.6x101.6x101.6e
inverse3      10g   -      1g    0.01g    4000g  460x510x230g
"""


def _of_row(row: str) -> DeviceLimits:
    model, *cells = row.split()
    known = {name: cell for name, cell in zip(_COLUMNS, cells, strict=True) if cell != "-"}
    values: dict[str, Any] = {
        name: tuple(map(float, cell[:-1].split("x"))) if name == "workspace" else float(cell[:-1])
        for name, cell in known.items()
    }
    return DeviceLimits(model, **values, sources={name: _SOURCES[cell[-1]] for name, cell in known.items()})


class KnownLimits(dict[str, DeviceLimits]):
    """Limits by model, printed as the table of docs/stability.md."""

    def __missing__(self, model: str) -> DeviceLimits:
        raise ValueError(f"model must be one of {', '.join(self)}, got {model!r}{nearest(model, self)}")

    def __repr__(self) -> str:
        heads = (f"{name} [{_UNITS[name]}]".replace("_per_", "/").replace("_", " ") for name in _COLUMNS)
        lines = [f"| model | {' | '.join(heads)} |", "|---" * (len(_COLUMNS) + 1) + "|"]
        rows = (f"| {' | '.join(row.split())} |" for row in _TABLE.strip().splitlines())
        lines += (re.sub(r"(?<= )([\d.x]+)([a-z]) ", r"\1 (\2) ", row) for row in rows)
        sources = [
            textwrap.fill(f"* ({letter}) {text}.", 110, subsequent_indent="  ", break_on_hyphens=False)
            for letter, text in _SOURCES.items()
        ]
        return "\n".join([*lines, "", *sources])


#: Limits of haptic devices by model, each number with its source; ValueError for an unknown model.
device_limits = KnownLimits({limits.model: limits for limits in map(_of_row, _TABLE.strip().splitlines())})


def limits_of_hardware(hardware: str) -> DeviceLimits:
    """The row of the model that a driver names; for one without a row the least forces of all."""
    words = f" {hardware.lower().replace('_', ' ')} "
    named = [model for model in device_limits if f" {model.replace('_', ' ')} " in words]
    if named:
        return device_limits[max(named, key=len)]
    peaks, lasting = (
        [force for row in device_limits.values() if (force := getattr(row, name)) is not None]
        for name in ("peak_force", "continuous_force")
    )
    return DeviceLimits(f"unknown model {hardware!r}", min(peaks), min(lasting))
