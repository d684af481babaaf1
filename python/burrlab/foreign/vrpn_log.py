"""Logs that the library VRPN wrote."""

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import burrlab._core as _core
from burrlab.common.check import amend_error, content_of, refuse
from burrlab.common.progress import doing


@dataclass(frozen=True, repr=False, eq=False)
class VrpnLog:
    """A log of VRPN: structured arrays by the sender's name, a row a message. Made by `read_vrpn_log`.

    The column `time` is the message's time stamp, since `started` [s].

    Attributes
    ----------
    path : Path
    started : float
        Earliest time stamp of the tables [s since epoch].
    poses : dict of str to ndarray
        Columns time, sensor, position [mm] and orientation, a quaternion (w, x, y, z).
    velocities : dict of str to ndarray
        Columns time, sensor, velocity [mm/s], and turn, the rotation (w, x, y, z) within step [s].
    forces : dict of str to ndarray
        Columns time and force [N].
    buttons : dict of str to ndarray
        Columns time, button and pressed; where the log tells the states of all buttons, a row each.
    other : dict of str to int
        Number of messages of each other type; of a type without a name, "type 7".
    """

    path: Path
    started: float
    poses: Mapping[str, NDArray[np.void]]
    velocities: Mapping[str, NDArray[np.void]]
    forces: Mapping[str, NDArray[np.void]]
    buttons: Mapping[str, NDArray[np.void]]
    other: Mapping[str, int]

    def __repr__(self) -> str:
        counts = (
            f"{len(rows)} {name} of {sender}"
            for name, _, _ in _TABLES.values()
            for sender, rows in getattr(self, name).items()
        )
        return f"VrpnLog({', '.join([*counts, f'{sum(self.other.values())} others'])})"


_COOKIE_SIZE = 24
_TURN = ("f8", 4)
#: Table of each kind of message: its name, the columns of its numbers, and those of its values.
_TABLES: dict[str, tuple[str, list[Any], list[Any]]] = {
    "pose": ("poses", [("sensor", "i4")], [("position", "f8", 3), ("orientation", *_TURN)]),
    "velocity": ("velocities", [("sensor", "i4")], [("velocity", "f8", 3), ("turn", *_TURN), ("step", "f8")]),
    "force": ("forces", [], [("force", "f8", 3)]),
    "button": ("buttons", [("button", "i4")], [("pressed", "?")]),
}


@doing("reading a log of VRPN")
def read_vrpn_log(path: str | os.PathLike[str]) -> VrpnLog:
    """The messages of Trackers, Buttons and ForceDevices in a log (.vrpn) that VRPN's library wrote.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    VrpnLog

    Raises
    ------
    ValueError
        If the file is not a log of major version 07, ends within a message, or holds one whose size or type cannot
        be, or whose numbers are not finite.
    OSError
        If the file cannot be read.

    Warns
    -----
    UserWarning
        If its minor version is not 38.

    Notes
    -----
    Read are Pos_Quat and Velocity of Trackers, Change and States of Buttons, and Force of ForceDevices, in the axes
    of their senders. Messages over UDP can come before the log names their numbers: they are of "sender 3", or
    counted as "type 7". How a Tracker's path drives a burr stands in docs/network.md.

    Examples
    --------
    >>> import burrlab
    >>> log = burrlab.read_vrpn_log("client_in.vrpn")  # doctest: +SKIP
    >>> log.poses["Tracker0"]["position"]  # doctest: +SKIP
    """
    file = Path(path)
    content = content_of(file)
    cookie = content[:_COOKIE_SIZE]
    begins = (
        f"it {'begins with' if len(cookie) == _COOKIE_SIZE else 'holds only'} {cookie.rstrip(bytes(1))!r}"
    )
    refuse(
        cookie[:14] != b"vrpn: ver. 07." or len(cookie) != _COOKIE_SIZE,
        f"{file} must be a log of VRPN 07, {begins}",
    )
    if cookie[14:16] != b"38":
        warnings.warn(f"{file} is read as a log of VRPN 07.38, {begins}", stacklevel=3)
    with amend_error(f"{file} is truncated or damaged: "):
        messages, other = _core.read_vrpn_log(content)
    started = min((int(times.min()) for _, _, times, _, _ in messages if len(times)), default=0)  # [us]
    tables: dict[str, dict[str, NDArray[np.void]]] = {name: {} for name, _, _ in _TABLES.values()}
    for kind, sender, times, numbers, values in messages:
        refuse(not np.isfinite(values).all(), f"{file}: a message of {sender!r} is not finite")
        name, number, columns = _TABLES[kind]
        table = tables[name][sender] = np.empty(len(times), [("time", "f8"), *number, *columns])
        table["time"] = (times - started) / 1e6
        for column, _ in number:
            table[column] = numbers
        fields = values.view([(column, "f8", *shape) for column, _, *shape in columns])[:, 0]
        table[[column for column, *_ in columns]] = fields
    return VrpnLog(file, started / 1e6, **tables, other=other)
