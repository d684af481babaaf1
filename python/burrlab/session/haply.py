"""A Haply Inverse3 over the Inverse Service, by JSON messages on a WebSocket."""

# Written from Haply's public documentation of version 3.5, the newest, below https://docs.haply.co/inverseSDK/service/
# * realtime/websocket-protocol: port 10001; the service tells of all devices on connection, then answers each message
#   by one with the state of all devices; a connection is a session;
# * realtime/control-commands: metres; set_cursor_force {"vector": ...} in newtons; a command is applied once, and
#   without further ones the device idles (public clients of earlier 3.x write "values"; 3.0, on port 10000, is
#   another format);
# * commons/basis: right-handed, x right, y forward, z up; commons/mount-and-workspace: origin at the base;
# * tutorials/02-print-versegrip and 03-print-wireless-versegrip, api/simulation: orientation, button, buttons a, b, c;
# * tutorials/05-position-control: status.calibrated.
# No source was found for the unit of cursor_velocity: the velocity here is the difference of two positions.

import atexit
import contextlib
import json
import os
import queue
import socket
import threading
import time
import weakref
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from burrlab._core import ForceWatchdog, MailboxDevice, ServoDevice
from burrlab.common.check import extra, refuse, shown, whole

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

PORT = 10001  #: Of the service, where its settings name no other
_OPEN_LIMIT = 0.5  # [s], of the connection, and of the first message
_ANSWER_LIMIT = 2.0  # [s], of an answer that is late
_SILENCE = 0.3  # of `lost_after`, after which the watchdog sends force zero
_RETURN = 0.01  # of the force a message, after that; ours
_PRIORITY = 79  # below the loop's
_PERIOD = 1e-3  # [s] between two messages of ours
_LARGEST = 1 << 20  # of a message of the service [bytes]; one of ten devices has some 20 000
_LONGEST = 100  # id
_GRIPS = ("verse_grip", "wireless_verse_grip")


class HaplyDevice(MailboxDevice):
    """A Haply Inverse3, with or without its VerseGrip, over Haply's Inverse Service.

    Written from the public documentation and tested against a mock of ours, not on hardware. Needs the extra
    `haply`. The axes are x right, y forward, z up, from the device's base [mm]. The orientation turns the
    VerseGrip's axes into these; it is 1 without one. Buttons 0, 1 and 2 are a, b and c.

    Parameters
    ----------
    host : str
        Where the Inverse Service runs.
    port : int
    lost_after : float
        Age at which a position is lost, and the session stops [ms].
    on_button : int, optional
        The burr turns while this button, 0 to 7, is pressed; default always.

    Raises
    ------
    ValueError
        If no service answers within a second, it does not have exactly one Inverse3 and at most one VerseGrip,
        or the device must be calibrated.
    ImportError
        Without the extra.

    Notes
    -----
    The device is connected while this object lives. A thread sends the loop's newest force, up to 1000 times a
    second, and reads the answer; the force is zero where no session runs. The velocity is the difference of two
    positions over the time between their answers. A lost connection, a wrong answer or none for `lost_after` ends
    the session with force zero; but for an answer that was only late, the device must then be opened anew.

    Where this thread cannot run for 0.3 `lost_after`, as other code holds Python's interpreter or the processor, a
    watchdog without Python sends force zero. Then the force grows back within 100 messages, and `note` says so if a
    force stood.
    """

    note = ""  #: That the watchdog has ended a force since the last session began, else empty

    def __init__(
        self, host: str = "localhost", port: int = PORT, *, lost_after: float = 100.0, on_button: int | None = None
    ) -> None:  # fmt: skip
        extra("websockets.sync.client", "a Haply device", "haply")
        refuse(not host or set(host) & set("/?#@[] "), f"host must be a name or an address, got {host!r}")
        self._on_button = None if on_button is None else whole("on_button", on_button, 8, "8")
        self._place = host, port
        address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        super().__init__(lost_after=lost_after, name=f"haply:{address}")
        self.library = f"ws://{address}"  #: Address of the service
        self._patience = lost_after / 1e3
        self._last: tuple[float, Any] | None = None
        self._share, self._pulls = 1.0, False  # of the loop's force, that is sent; whether that is above zero
        opened: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._thread = threading.Thread(target=_exchange, args=(weakref.ref(self), opened), daemon=True)
        self._thread.start()
        refuse(why_not := opened.get(), why_not)

    def _open(self, message: dict[str, Any]) -> None:
        """Takes the first message, with all devices."""
        arms = _listed(message, "inverse3")
        grips = [(kind, identifier) for kind in _GRIPS for identifier in _listed(message, kind)]
        names = ", ".join([*arms, *(identifier for _, identifier in grips)]) or "none"
        refuse(
            len(arms) != 1 or len(grips) > 1,
            f"the service must have exactly one Inverse3 and at most one VerseGrip, got {names}",
        )
        ((self._id, arm),) = arms.items()
        end = time.monotonic() + _OPEN_LIMIT
        while (other := _OPEN.get(self._id)) is not None and not other.fault:
            refuse(time.monotonic() > end, f"the Inverse3 {self._id} is open already")
            del other  # its owner may have dropped it: then only its thread holds it, for a turn
            time.sleep(_PERIOD)
        status = arm.get("status")
        refuse(
            isinstance(status, dict) and status.get("calibrated") is False,
            f"the Inverse3 {self._id} must be calibrated, as its manual says",
        )
        self._grip = grips[0] if grips else None
        #: Kinds of the devices, with their ids
        self.hardware = ", ".join(
            f"{kind} {identifier}" for kind, identifier in [("inverse3", self._id), *grips]
        )
        self._read(message)
        _OPEN[self._id] = self

    def _read(self, message: dict[str, Any]) -> None:
        """Puts the state in a message into the mailbox."""
        now = time.monotonic()
        position = 1e3 * np.array(_numbers(_state(message, "inverse3", self._id), "cursor_position", "xyz"))
        velocity = np.zeros(3) if self._last is None else (position - self._last[1]) / (now - self._last[0])
        self._last = now, position
        orientation, buttons = [1.0, 0.0, 0.0, 0.0], 0
        if self._grip is not None:
            state = _state(message, *self._grip)
            orientation = _numbers(state, "orientation", "wxyz")
            pressed = state.get("buttons", {"a": state.get("button")})
            known: dict[str, Any] = pressed if isinstance(pressed, dict) else {"a": None}
            flags = [known.get(one, False) for one in "abc"]
            if not all(isinstance(one, bool) for one in flags):
                raise ValueError(f"the grip's buttons must be true or false, got {shown(pressed)}")
            buttons = sum(flag << i for i, flag in enumerate(flags))
        on = self._on_button is None or bool(buttons >> self._on_button & 1)
        self.put(position, velocity, on, orientation, buttons)

    def _turn(self, connection: "ClientConnection", watchdog: ForceWatchdog) -> None:
        """One message and its answer, or what the service sent since. If late, force zero: the loop finds the
        position too old."""
        if self._live(watchdog):
            _newest(connection, _PERIOD)  # the answer to the watchdog
        force = self._share * self.force
        self._pulls = bool(force.any())
        connection.send(_command(self._id, force))
        self._share = min(1.0, self._share + _RETURN)
        try:
            text = self._answer(connection, watchdog, self._patience)
        except TimeoutError:
            connection.send(_command(self._id, (0, 0, 0)))
            self._answer(connection, watchdog, _ANSWER_LIMIT)
            text = self._answer(connection, watchdog, _ANSWER_LIMIT)
        text = _newest(connection, 0) or text  # a message more would make all later positions old
        self._read(_parsed(text))

    def _answer(self, connection: "ClientConnection", watchdog: ForceWatchdog, limit: float) -> str | bytes:
        """The next message; TimeoutError if none comes within the limit [s]."""
        end = time.monotonic() + limit
        while (left := end - time.monotonic()) > 0:
            with contextlib.suppress(TimeoutError):
                return connection.recv(timeout=min(left, 0.1 * self._patience))
            self._live(watchdog)
        raise TimeoutError

    def _live(self, watchdog: ForceWatchdog) -> bool:
        """Says that Python runs; whether the watchdog had acted, after which the force grows from zero."""
        if rested := watchdog.beat():
            self._share = 0.0
        if rested and self._pulls:
            self.note = f"{self.name}: its force was zero for a time, as this program's Python was held up"
        return rested


def _newest(connection: "ClientConnection", timeout: float) -> str | bytes | None:
    """The first message within the time [s] and those that are there already: the last of them."""
    text = None
    with contextlib.suppress(TimeoutError):
        while True:
            text = connection.recv(timeout=timeout if text is None else 0)
    return text


_OPEN: weakref.WeakValueDictionary[str, HaplyDevice] = weakref.WeakValueDictionary()  # by id

_ENDING = threading.Event()


@atexit.register  # before a session registers its own handler, which then runs earlier
def end_exchanges() -> None:
    """The program ends: each service gets force zero first."""
    _ENDING.set()
    for device in list(_OPEN.values()):
        device._thread.join(_ANSWER_LIMIT)


class _Socket(socket.socket):
    """A socket that sends as its watchdog does, so that their messages do not mix."""

    watchdog: ForceWatchdog | None = None

    def sendall(self, data: Any, flags: int = 0) -> None:
        if self.watchdog is None:
            super().sendall(data, flags)
        else:
            refuse(not self.watchdog.send(bytes(data)), "the connection takes no messages", OSError)


#: Devices that a hand holds, which need the wall clock.
HeldDevice: TypeAlias = ServoDevice | HaplyDevice


def _exchange(alive: weakref.ref[HaplyDevice], opened: queue.SimpleQueue[str]) -> None:
    """Opens the device and says why not, empty if so. Then exchanges messages until it is gone or fails."""
    from websockets.frames import Frame, Opcode
    from websockets.sync.client import connect

    with contextlib.suppress(OSError, AttributeError):  # as the loop does; also for the library's thread
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    device, what = alive(), "must be a running Inverse Service"
    assert device is not None  # its constructor waits
    try:
        plain = _Socket(fileno=socket.create_connection(device._place, _OPEN_LIMIT).detach())
        with connect(
            device.library, sock=plain, open_timeout=_OPEN_LIMIT, close_timeout=_OPEN_LIMIT, ping_interval=None,
            compression=None, max_size=_LARGEST, proxy=None,
        ) as connection:  # fmt: skip
            what = "cannot be used"
            device._open(_parsed(connection.recv(timeout=_OPEN_LIMIT)))
            what, rest, deadline = "failed", _command(device._id, (0, 0, 0)), time.monotonic()
            frame = Frame(Opcode.TEXT, rest.encode()).serialize(mask=True)
            silence = 1e3 * _SILENCE * device._patience
            plain.watchdog = watchdog = ForceWatchdog(plain.fileno(), frame, silence)
            opened.put("")
            try:
                while device is not None and not _ENDING.is_set():
                    device._turn(connection, watchdog)
                    device = None
                    deadline = max(deadline + _PERIOD, time.monotonic())
                    time.sleep(max(0.0, deadline - time.monotonic()))
                    device = alive()
            finally:
                with contextlib.suppress(Exception):
                    connection.send(rest)
                plain.watchdog = None  # its descriptor too must close
                del watchdog
    except Exception as error:  # whatever it is, the session must know
        if (device := alive()) is not None:
            device.fail(f"{device.name} {what}: {_said(error)}")
            opened.put(device.fault)


def _said(error: Exception) -> str:
    from websockets.exceptions import ConnectionClosed

    if isinstance(error, TimeoutError):
        return "the service did not answer in time"
    if isinstance(error, ConnectionClosed):
        return f"the connection ended ({error})"
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _command(device: str, force: Any) -> str:
    command = {"set_cursor_force": {"vector": dict(zip("xyz", map(float, force), strict=True))}}
    return json.dumps({"inverse3": [{"device_id": device, "commands": command}]})


def _parsed(text: str | bytes) -> dict[str, Any]:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        message = None
    if not isinstance(message, dict):
        raise ValueError(f"the service must send JSON objects, got {shown(text)}")
    return message


def _listed(message: dict[str, Any], kind: str) -> dict[str, Any]:
    """Devices of a kind by their id."""
    devices = message.get(kind, [])
    good = isinstance(devices, list) and all(isinstance(device, dict) for device in devices)
    names = [device.get("device_id") for device in devices] if good else []
    fit = [isinstance(name, str) and name.isprintable() and len(name) < _LONGEST for name in names]
    if not good or not all(fit) or len({*names}) < len(names):
        raise ValueError(f"{kind} must be devices with an id each, got {shown(devices)}")
    return dict(zip(names, devices, strict=True))


def _state(message: dict[str, Any], kind: str, device: str) -> dict[str, Any]:
    state = _listed(message, kind).get(device, {}).get("state")
    if not isinstance(state, dict):
        raise ValueError(f"the service must send the state of {kind} {device}, got {shown(message)}")
    return state


def _numbers(state: dict[str, Any], field: str, axes: str) -> list[float]:
    by_axis = state.get(field)
    values: list[Any] = [by_axis.get(axis) for axis in axes] if isinstance(by_axis, dict) else [None]
    if not all(type(number) in (int, float) and abs(number) < 1e6 for number in values):
        raise ValueError(f"{field} must be numbers {', '.join(axes)}, got {shown(by_axis)}")
    return values
