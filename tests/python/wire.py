"""Messages of OpenIGTLink and VRPN as docs/wire.md defines them, for peers in tests: they share no code with the core."""

import struct
from typing import Any, NamedTuple

import numpy as np

NEWTON = (0x0B << 54) | (1 << 50)
VRPN_COOKIE = b"vrpn: ver. 07.38  0".ljust(24, b"\0")


def _crc_of_byte(byte):
    crc = byte << 56
    for _ in range(8):
        crc = (crc << 1) ^ (0x142F0E1EBA9EA3693 if crc >> 63 else 0)
    return crc


_CRC = [_crc_of_byte(byte) for byte in range(256)]


def crc64(data):
    """Checksum of ECMA-182, begun at 0."""
    crc = 0
    for byte in data:
        crc = _CRC[crc >> 56 ^ byte] ^ (crc << 8 & 0xFFFFFFFFFFFFFFFF)
    return crc


def message(kind, name, content, *, timestamp=0.0, version=1):
    if version == 2:
        content = struct.pack(">HHII", 12, 2, 0, 0) + content + bytes(2)  # no metadata
    head = version, kind.encode(), name.encode(), int(timestamp * 2**32), len(content), crc64(content)
    return struct.pack(">H12s20sQQQ", *head) + content


def transform(name, position, rotation=None, **options):
    columns = np.vstack([np.eye(3) if rotation is None else np.transpose(rotation), position])
    return message("TRANSFORM", name, columns.astype(">f4").tobytes(), **options)


def sensor(name, values, **options):
    content = struct.pack(">BBQ", len(values), 0, NEWTON) + np.asarray(values, ">f8").tobytes()
    return message("SENSOR", name, content, **options)


def numbers(name, values, **options):
    """An NDARRAY of float64 in one dimension."""
    content = struct.pack(">BBH", 11, 1, len(values)) + np.asarray(values, ">f8").tobytes()
    return message("NDARRAY", name, content, **options)


def byte_string(name, data, **options):
    """An NDARRAY of uint8 that holds a length, the bytes and zeros up to whole rows."""
    rows = -(-(8 + len(data)) // 65535)
    columns = -(-(8 + len(data)) // rows)
    shape = (columns,) if rows == 1 else (rows, columns)
    head = struct.pack(f">BB{len(shape)}HQ", 3, len(shape), *shape, len(data))
    return message("NDARRAY", name, head + data.ljust(rows * columns - 8, b"\0"), **options)


class Received(NamedTuple):
    type: str
    name: str
    version: int
    value: Any  # TRANSFORM: (4, 4); SENSOR and NDARRAY: numbers, or the bytes of a byte string


def decoded(data):
    """A whole message, whose checksum must be right."""
    version, kind, name, _, size, crc = struct.unpack(">H12s20sQQQ", data[:58])
    content = data[58:]
    assert (size, crc) == (len(content), crc64(content))
    if version == 2:
        extended, keys, values, _ = struct.unpack_from(">HHII", content)
        content = content[extended : len(content) - keys - values]
    kind, name = (text.rstrip(b"\0").decode() for text in (kind, name))
    value = content
    if kind == "TRANSFORM":
        value = np.eye(4, dtype=np.float32)
        value[:3] = np.frombuffer(content, ">f4").reshape(4, 3).T
    elif kind == "SENSOR":
        count, _, unit = struct.unpack_from(">BBQ", content)
        assert unit == NEWTON
        value = np.frombuffer(content, ">f8", count, 10)
    elif kind == "NDARRAY":
        begin = 2 + 2 * content[1]
        if content[0] == 11:
            value = np.frombuffer(content, ">f8", offset=begin)
        else:
            value = content[begin + 8 :][: int.from_bytes(content[begin : begin + 8])]
    return Received(kind, name, version, value)


class Stream:
    """Messages from a socket's bytes in any pieces."""

    def __init__(self):
        self.left = b""

    def feed(self, data):
        self.left += data
        messages = []
        while len(self.left) >= 58 and len(self.left) >= (end := 58 + int.from_bytes(self.left[42:50])):
            messages.append(decoded(self.left[:end]))
            self.left = self.left[end:]
        return messages


class VrpnStream:
    """VRPN's messages likewise: (type, sender, payload), by their names. A cookie has the type "cookie"."""

    def __init__(self):
        self.left, self.names = b"", {-1: {}, -2: {-1: "sender", -2: "type", -3: "udp"}}

    def feed(self, data, *, cookie=True):
        self.left += data
        messages = []
        if cookie and not self.names[-1] and len(self.left) >= 24:
            messages.append(("cookie", "", self.left[:24]))
            self.names[-1] = {0: ""}
            self.left = self.left[24:]
        while len(self.left) >= 24:
            size, _, _, sender, kind, _ = struct.unpack_from(">IIIiiI", self.left)
            if len(self.left) < (end := -(-size // 8) * 8):
                break
            payload, self.left = self.left[24:size], self.left[end:]
            if kind in (-1, -2):
                self.names[kind][sender] = payload[4:-1].decode()
            messages.append((self.names[-2][kind], self.names[-1].get(sender, ""), payload))
        return messages
