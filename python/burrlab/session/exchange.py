"""Devices from text and CSV files; logs of VRPN."""

import os
import re
import struct
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import scipy
from numpy.typing import NDArray

import burrlab.common.table as csv_text
from burrlab._core import (
    IgtlDevice,
    OmegaDevice,
    ScriptedDevice,
    TouchDevice,
    VrpnDevice,
)
from burrlab.bone.image import OnGrid
from burrlab.common.check import refuse
from burrlab.common.progress import doing
from burrlab.session.haply import PORT, HaplyDevice, HeldDevice


def _finite(value: float, unit: str) -> str | None:
    return csv_text.finite(value, "")


SCRIPT = csv_text.Table(
    (
        csv_text.Column("time", "s", check=_finite, due="a time"),
        *(csv_text.Column(axis, "mm", check=_finite, due="a position") for axis in "xyz"),
        csv_text.Column(
            "on",
            check=lambda value, unit: None if value in (0.0, 1.0) else f"must be 0 or 1: got {value!r}",
            optional=True,
            due="0 or 1",
        ),
        *(csv_text.Column(f"q{axis}", check=_finite, optional=True, due="an orientation") for axis in "wxyz"),
    )
)


def read_script(file: csv_text.Path | IO[str] | IO[bytes], *, volume: OnGrid | None = None) -> ScriptedDevice:
    """A device that follows the path in a CSV file.

    Parameters
    ----------
    file : path or file object
        Columns time_s (increasing), x_mm, y_mm, z_mm (centre of the burr, bone frame) and optionally on (1:
        the burr turns from this row to the next), and qw, qx, qy, qz (unit quaternion that turns directions
        of the tool into those of the bone). Without `on` it always turns. Lines that begin with # above the
        column names are comments.
    volume : Volume or LabelVolume, optional
        The script is in this volume's own coordinates, as an entry is, and is turned into the bone frame.

    Returns
    -------
    ScriptedDevice

    Raises
    ------
    ValueError
        If a column is missing, a field is not a finite number, `on` is not 0 or 1, the times do not increase, or
        an orientation is not of length 1 or the volume mirrors it. The message names the file, and line and column where possible.
    OSError
        If the file cannot be opened.
    """
    name, _, columns = SCRIPT.read(file)
    position = np.column_stack([columns["x"], columns["y"], columns["z"]])
    on = np.asarray(columns["on"]) > 0 if "on" in columns else None
    turns = [columns[one] for one in ("qw", "qx", "qy", "qz") if one in columns]
    refuse(len(turns) not in (0, 4), f"{name}: an orientation needs all of the columns qw, qx, qy, qz")
    time, turn = np.asarray(columns["time"]), np.column_stack(turns) if turns else None
    try:
        device = ScriptedDevice(time, position, on, turn)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if volume is None:
        return device
    if turn is not None:
        mirrored = np.linalg.det(volume.direction) < 0
        refuse(mirrored, f"{name}: no orientation can be given in coordinates that mirror the bone frame")
        rotation = scipy.spatial.transform.Rotation
        orientation = rotation.from_quat(np.roll(turn, -1, axis=1))
        turn = np.roll((rotation.from_matrix(volume.direction.T) * orientation).as_quat(), 1, axis=1)
    return ScriptedDevice(time, volume.bone_point(position.T).T, on, turn)


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
    wire = {key: np.frombuffer(one, [("time", ">u4", 2), *_TABLES[key[0]][1]]) for key, one in rows.items()}
    times = {key: one["time"].astype(np.int64) @ (10**6, 1) for key, one in wire.items()}  # [us]
    started = min((int(one.min()) for one in times.values()), default=0)
    tables: dict[str, dict[str, NDArray[np.void]]] = {name: {} for name, _ in _TABLES.values()}
    for (kind, sender), given in wire.items():
        name, fields = _TABLES[kind]
        ours = [
            (one, "?" if one == "pressed" else form[1:], *shape) for one, form, *shape in fields if one != "_"
        ]
        table = tables[name][sender] = np.empty(len(given), [("time", "f8"), *ours])
        table["time"] = (times[kind, sender] - started) / 1e6
        for column, *_ in ours:
            value = given[column]
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


VRPN_PORT = 3883


@dataclass(frozen=True)
class DeviceText:
    """The parts of a device text, as `--device` takes it.

    Attributes
    ----------
    kind : {"hand", "scripted", "igtl", "vrpn", "touch", "omega", "haply"}
    file : str
        Script to follow.
    host : str
    port : int
        OpenIGTLink or VRPN server, or Haply's Inverse Service.
    name : str
        Of a touch in the vendor's set-up, empty for the default device; of a VRPN Tracker.
    index : int
        Of an omega.
    tcp : bool
        Connect to the VRPN server directly.
    """

    kind: str
    file: str = ""
    host: str = ""
    port: int = 0
    name: str = ""
    index: int = 0
    tcp: bool = False


def parse_device(text: str) -> DeviceText:
    """The parts of a device text.

    Raises
    ------
    ValueError
        If the text has another form.

    Examples
    --------
    >>> parse_device("omega:1").index
    1
    """
    kind, _, rest = text.partition(":")
    if text in ("hand", "touch", "omega"):
        return DeviceText(text)
    if text == "haply":
        return DeviceText("haply", host="localhost", port=PORT)
    if kind == "scripted" and rest:
        return DeviceText("scripted", file=rest)
    if kind == "touch" and rest:
        return DeviceText("touch", name=rest)
    if kind == "omega" and rest.isdecimal():
        return DeviceText("omega", index=int(rest))
    if kind not in ("igtl", "haply", "vrpn") or not rest:
        raise ValueError(
            "must be hand, scripted:FILE, igtl:HOST:PORT, touch[:NAME], omega[:N], haply[:HOST:PORT] or "
            f"vrpn:NAME@[tcp://]HOST[:PORT], got '{text}'"
        )
    try:
        return _at_server(kind, rest)
    except ValueError as error:
        raise ValueError(f"{kind}: {error}") from None


def _at_server(kind: str, text: str) -> DeviceText:
    if kind != "vrpn":
        return DeviceText(kind, "", *parse_address(text))
    name, _, server = text.rpartition("@")
    address = server.removeprefix("tcp://")
    refuse(not (name and address), f"must be NAME@HOST[:PORT] or NAME@tcp://HOST[:PORT], got '{text}'")
    port = "" if re.search(r":[^:\]]+$", address) else f":{VRPN_PORT}"
    return DeviceText(kind, "", *parse_address(address + port), name, tcp=address != server)


def open_device(device: DeviceText, lost_after: float) -> IgtlDevice | VrpnDevice | HeldDevice:
    """Opens a device that moves by itself: igtl, vrpn, touch, omega or haply.

    Raises
    ------
    ValueError
        If it cannot be opened.
    ImportError
        For haply without the extra.
    """
    if device.kind == "touch":
        return TouchDevice(device.name, lost_after=lost_after)
    if device.kind == "omega":
        return OmegaDevice(device.index, lost_after=lost_after)
    if device.kind == "vrpn":
        return VrpnDevice(device.name, device.host, device.port, tcp=device.tcp, lost_after=lost_after)
    at_server = HaplyDevice if device.kind == "haply" else IgtlDevice
    return at_server(device.host, device.port, lost_after=lost_after)


def find_devices(doing: Callable[[str], AbstractContextManager[None]]) -> list[dict[str, str]]:
    """What was looked for: one row for each device that was found, or for a kind of which none was.

    Parameters
    ----------
    doing : callable
        Gives the context in which a device is opened, from a text that says which.

    Returns
    -------
    list of dict
        `device`, as `--device` takes it; `needs`, the vendor's library or service; then `hardware`, its model,
        and `library`, the file that was loaded or the service's address; or `why_not`, a sentence.
    """
    try:
        count = OmegaDevice.count()
    except ValueError:
        count = 0
    omegas = {f"omega:{index}": "libdhd of Force Dimension" for index in range(max(count, 1))}
    rows = []
    for text, needs in {
        "touch": "libHD of OpenHaptics",
        **omegas,
        "haply": "Haply's Inverse Service",
    }.items():
        row = {"device": text, "needs": needs}
        try:
            with doing(f"looking for {text}, over {needs}"):
                device = open_device(parse_device(text), 100.0)
            assert isinstance(device, HeldDevice)
            row |= {"hardware": device.hardware, "library": device.library}
        except (ValueError, ImportError) as error:
            row["why_not"] = str(error)
        rows.append(row)
    return rows


def parse_address(text: str) -> tuple[str, int]:
    """Host and port of a text HOST:PORT.

    Raises
    ------
    ValueError
        If the text is not HOST:PORT with a port of 1 to 65535.
    """
    host, colon, port = text.rpartition(":")
    refuse(
        not (colon and host and port.isdecimal() and 0 < int(port) < 65536),
        f"must be HOST:PORT, got '{text}'",
    )
    return host.strip("[]"), int(port)
