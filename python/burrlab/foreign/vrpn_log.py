"""Logs that the library VRPN wrote."""

import os
import struct
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.common.check import refuse
from burrlab.common.progress import doing


@dataclass(frozen=True, repr=False, eq=False)
class VrpnLog:
    """A log of VRPN: tables by the sender's name, structured arrays with a row for each message, in the file's order.

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
        tables = ("poses", "velocities", "forces", "buttons")
        counts = (
            f"{len(rows)} {name} of {sender}"
            for name in tables
            for sender, rows in getattr(self, name).items()
        )
        return f"VrpnLog({', '.join([*counts, f'{sum(self.other.values())} others'])})"


_HEAD = struct.Struct(">ii8sI4x")  # type, sender, time stamp, size of the payload, nothing
_SENDER, _TYPE = -1, -2  # messages that give a number its name
_TYPES = range(-5, 2000)  # VRPN's own, and those with a name
_CHANGE, _STATES = "vrpn_Button Change", "vrpn_Button States"
_SENSOR = [("sensor", ">i4"), ("_", "V4")]
#: Table of each type that is read, and its payload [m, m/s, N], quaternions (x, y, z, w).
_TABLES: dict[str, tuple[str, list[Any]]] = {
    "vrpn_Tracker Pos_Quat": ("poses", [*_SENSOR, ("position", ">f8", 3), ("orientation", ">f8", 4)]),
    "vrpn_Tracker Velocity": ("velocities", [*_SENSOR, ("velocity", ">f8", 3), ("turn", ">f8", 4), ("step", ">f8")]),
    "vrpn_ForceDevice Force": ("forces", [("force", ">f8", 3)]),
    _CHANGE: ("buttons", [("button", ">i4"), ("pressed", ">i4")]),
}  # fmt: skip
_SIZES = {kind: np.dtype(payload).itemsize for kind, (_, payload) in _TABLES.items()}


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
    """
    file, other = Path(path), Counter[str]()
    rows: dict[tuple[str, str], bytearray] = defaultdict(bytearray)
    for kind, sender, stamp, payload in _messages(file):
        if kind in _TABLES:
            rows[kind, sender] += stamp + payload
        elif kind == _STATES:
            for button, state in enumerate(struct.unpack_from(f">{len(payload) // 4 - 1}i", payload, 4)):
                rows[_CHANGE, sender] += stamp + struct.pack(">2i", button, state)
        else:
            other[kind] += 1
    wire = {
        key: np.frombuffer(packed, [("time", ">u4", 2), *_TABLES[key[0]][1]]) for key, packed in rows.items()
    }
    times = {key: messages["time"].astype(np.int64) @ (10**6, 1) for key, messages in wire.items()}  # [us]
    started = min((int(stamps.min()) for stamps in times.values()), default=0)
    tables: dict[str, dict[str, NDArray[np.void]]] = {name: {} for name, _ in _TABLES.values()}
    for (kind, sender), messages in wire.items():
        name, fields = _TABLES[kind]
        columns = [
            (column, "?" if column == "pressed" else form[1:], *shape)
            for column, form, *shape in fields if column != "_"
        ]  # fmt: skip
        table = tables[name][sender] = np.empty(len(messages), [("time", "f8"), *columns])
        table["time"] = (times[kind, sender] - started) / 1e6
        for column, *_ in columns:
            value = messages[column]
            refuse(not np.isfinite(value).all(), f"{file}: a message of {sender!r} is not finite")
            if column in ("position", "velocity"):
                value = 1e3 * value
            elif column in ("orientation", "turn"):
                value = np.roll(value, 1, axis=1)
            table[column] = value
    return VrpnLog(file, started / 1e6, **tables, other=dict(other))


def _messages(file: Path) -> Iterator[tuple[str, str, bytes, bytes]]:
    """Type, sender, time stamp and payload of each message; those of the types that are read have their size."""
    names: dict[int, dict[int, str]] = {_SENDER: {}, _TYPE: {}}
    with open(file, "rb") as log:
        cookie, end, at = log.read(_HEAD.size), os.fstat(log.fileno()).st_size, _HEAD.size
        begins = f"it {'begins with' if len(cookie) == at else 'holds only'} {cookie.rstrip(bytes(1))!r}"
        of_07 = cookie[:14] == b"vrpn: ver. 07." and len(cookie) == at
        refuse(not of_07, f"{file} must be a log of VRPN 07, {begins}")
        if cookie[14:16] != b"38":
            warnings.warn(f"{file} is read as a log of VRPN 07.38, {begins}", stacklevel=4)
        while head := log.read(_HEAD.size):
            kind, number, stamp, size = _HEAD.unpack(head.ljust(_HEAD.size))
            payload = log.read(min(size, end))  # a size that lies costs no memory
            name = names[_TYPE].get(kind, f"type {kind}")
            expected = _SIZES.get(name, size)
            if kind in names:
                expected = 4 + int.from_bytes(payload[:4])
            elif name == _STATES:
                expected = 4 + 4 * int.from_bytes(payload[:4])
            if len(head) < _HEAD.size or not len(payload) == size == expected or kind not in _TYPES:
                raise ValueError(f"{file} is truncated or damaged: at byte {at} stands no whole message")
            at += _HEAD.size + size
            if kind in names:
                names[kind][number] = payload[4:].rstrip(b"\0").decode(errors="replace")
            elif kind >= 0:
                yield name, names[_SENDER].get(number, f"sender {number}"), stamp, payload
