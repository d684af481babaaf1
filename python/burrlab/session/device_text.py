"""What moves a burr, in one word of text: of the command line and of protocols."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

DeviceKind = Literal["hand", "scripted", "igtl"]


@dataclass(frozen=True)
class DeviceText:
    """hand, scripted:FILE or igtl:HOST:PORT, taken apart.

    Attributes
    ----------
    kind : {"hand", "scripted", "igtl"}
    file : str
        Of a script.
    host : str
    port : int
        Of an OpenIGTLink server.
    """

    kind: DeviceKind
    file: str = ""
    host: str = ""
    port: int = 0


def parse_device(text: str) -> DeviceText:
    """A device from its text.

    Raises
    ------
    ValueError
        If the text is none of these.

    Examples
    --------
    >>> parse_device("igtl:localhost:18944")
    DeviceText(kind='igtl', file='', host='localhost', port=18944)
    """
    kind, _, rest = text.partition(":")
    if text == "hand":
        return DeviceText("hand")
    if kind == "scripted" and rest:
        return DeviceText("scripted", file=rest)
    if kind == "igtl" and rest:
        try:
            host, port = parse_address(rest)
        except ValueError as error:
            raise ValueError(f"igtl: {error}") from None
        return DeviceText("igtl", host=host, port=port)
    raise ValueError(f"must be hand, scripted:FILE or igtl:HOST:PORT, got '{text}'")


def parse_address(text: str) -> tuple[str, int]:
    """Host and port.

    Raises
    ------
    ValueError
        If the text is no HOST:PORT with a port of 1 to 65535.
    """
    host, colon, port = text.rpartition(":")
    if not colon or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"must be HOST:PORT, got '{text}'")
    return host.strip("[]"), int(port)
