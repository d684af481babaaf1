"""Devices from text and CSV files."""

import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import IO

import numpy as np
import scipy

import burrlab.common.table as table
from burrlab._core import (
    IgtlDevice,
    OmegaDevice,
    ScriptedDevice,
    TouchDevice,
    VrpnDevice,
)
from burrlab.bone.image import OnGrid
from burrlab.common.check import amend_error, refuse
from burrlab.session.haply import PORT, HaplyDevice, HeldDevice


def _finite(value: float, unit: str) -> str | None:
    return table.finite(value, "")


SCRIPT = table.Table(
    (
        table.Column("time", "s", check=_finite, due="a time"),
        *(table.Column(axis, "mm", check=_finite, due="a position") for axis in "xyz"),
        table.Column(
            "on",
            check=lambda value, unit: None if value in (0.0, 1.0) else f"must be 0 or 1: got {value!r}",
            optional=True,
            due="0 or 1",
        ),
        *(table.Column(f"q{axis}", check=_finite, optional=True, due="an orientation") for axis in "wxyz"),
    )
)


def read_script(file: table.Path | IO[str] | IO[bytes], *, volume: OnGrid | None = None) -> ScriptedDevice:
    r"""A device that follows the path in a CSV file.

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

    Examples
    --------
    >>> import io
    >>> device = read_script(io.StringIO("time_s,x_mm,y_mm,z_mm,on\n0,0,0,4,1\n1,0,0,3,1\n"))
    >>> device.name
    'script'
    """
    name, _, columns = SCRIPT.read(file)
    position = np.column_stack([columns["x"], columns["y"], columns["z"]])
    on = np.asarray(columns["on"]) > 0 if "on" in columns else None
    turns = [columns[one] for one in ("qw", "qx", "qy", "qz") if one in columns]
    refuse(len(turns) not in (0, 4), f"{name}: an orientation needs all of the columns qw, qx, qy, qz")
    time, turn = np.asarray(columns["time"]), np.column_stack(turns) if turns else None
    with amend_error(f"{name}: "):
        device = ScriptedDevice(time, position, on, turn)
    if volume is None:
        return device
    if turn is not None:
        refuse(
            np.linalg.det(volume.direction) < 0,
            f"{name}: no orientation can be given in coordinates that mirror the bone frame",
        )
        rotation = scipy.spatial.transform.Rotation
        orientation = rotation.from_quat(np.roll(turn, -1, axis=1))
        turn = np.roll((rotation.from_matrix(volume.direction.T) * orientation).as_quat(), 1, axis=1)
    return ScriptedDevice(time, volume.bone_point(position.T).T, on, turn)


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
    if text in ("hand", "touch", "omega"):
        return DeviceText(text)
    kind, _, rest = ("haply", "", f"localhost:{PORT}") if text == "haply" else text.partition(":")
    refuse(
        kind not in _KINDS or not rest or (kind == "omega" and not rest.isdecimal()),
        "must be hand, scripted:FILE, igtl:HOST:PORT, touch[:NAME], omega[:N], haply[:HOST:PORT] or "
        f"vrpn:NAME@[tcp://]HOST[:PORT], got '{text}'",
    )
    with amend_error(f"{kind}: "):
        return _KINDS[kind](rest)


def _vrpn(text: str) -> DeviceText:
    name, _, server = text.rpartition("@")
    address = server.removeprefix("tcp://")
    refuse(not (name and address), f"must be NAME@HOST[:PORT] or NAME@tcp://HOST[:PORT], got '{text}'")
    port = "" if re.search(r":[^:\]]+$", address) else f":{VRPN_PORT}"
    return DeviceText("vrpn", "", *parse_address(address + port), name, tcp=address != server)


#: Readers of what follows a kind and its colon.
_KINDS: dict[str, Callable[[str], DeviceText]] = {
    "scripted": lambda text: DeviceText("scripted", file=text),
    "touch": lambda text: DeviceText("touch", name=text),
    "omega": lambda text: DeviceText("omega", index=int(text)),
    "igtl": lambda text: DeviceText("igtl", "", *parse_address(text)),
    "haply": lambda text: DeviceText("haply", "", *parse_address(text)),
    "vrpn": _vrpn,
}


def open_device(device: DeviceText, lost_after: float) -> IgtlDevice | VrpnDevice | HeldDevice:
    """Opens a device that moves by itself: igtl, vrpn, touch, omega or haply.

    Raises
    ------
    ValueError
        If it cannot be opened.
    ImportError
        For haply without the extra.
    """
    host, port = device.host, device.port
    openers: dict[str, Callable[[], IgtlDevice | VrpnDevice | HeldDevice]] = {
        "touch": lambda: TouchDevice(device.name, lost_after=lost_after),
        "omega": lambda: OmegaDevice(device.index, lost_after=lost_after),
        "vrpn": lambda: VrpnDevice(device.name, host, port, tcp=device.tcp, lost_after=lost_after),
        "haply": lambda: HaplyDevice(host, port, lost_after=lost_after),
        "igtl": lambda: IgtlDevice(host, port, lost_after=lost_after),
    }
    return openers[device.kind]()


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
    rows = []
    for text, needs in {
        "touch": "libHD of OpenHaptics",
        **{f"omega:{index}": "libdhd of Force Dimension" for index in range(max(count, 1))},
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
