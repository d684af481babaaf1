"""Changes inputs of the fuzz test: as bytes, as text, and within packed or signed content."""

import contextlib
import gzip
import io
import json
import re
import struct
import zlib
from collections.abc import Callable
from random import Random
from typing import Any

import h5py
import numpy as np
from wire import crc64

from burrlab.psychophysics.side_car import digest

Files = dict[str, bytes]  # contents by names in the folder of an input
LARGEST = 1 << 22  # largest file [bytes]

_EDGES = [0, 1, 2, 127, 128, 255, 256, *(2**n - k for n in (15, 16, 31, 32, 63, 64) for k in (0, 1))]
_WORDS = ["nan", "inf", "-inf", "1e400", "1e-400", "-1", "0", "-0.0", "1e300", "99", "10000", "2147483648", "0x10", "1_0", "\u0661",
          "none", "true", "raw", "gzip", "LIST", "LOCAL", "%d", "..", "/dev/zero", "[*a,*a]", "&a", '"', "'", "#", ";", ",", "=", "",
          "\0", "\t", "\r", "\x7f", "\x85", "\u2028", "\ufeff", "9" * 20, "9" * 5000, "x" * 10_000, "[" * 5000, "{a: " * 2000]  # fmt: skip
_VALUES = [
    None,
    True,
    -1,
    0,
    2**64,
    10**400,
    1e300,
    np.nan,
    np.inf,
    [],
    {},
    [[]],
    [0.5] * 3,
    {"": 0},
    "\ud800",
    "DEEP",
]
_ARRAYS = [h5py.Empty("f8"), np.float64(np.nan), np.float64(1e300), np.int64(-1), np.uint64(2**64 - 1), np.zeros(0), np.zeros((2, 2)),
           np.zeros((4, 4, 4), "u1"), np.bytes_(b"\xff"), "x" * 10_000, "[" * 50_000, "{}", b"{}"]  # fmt: skip
_CHUNKS = [b"tRNS", b"PLTE", b"iCCP", b"zTXt", b"iTXt", b"acTL", b"fcTL", b"gAMA", b"eXIf", b"IHDR", b"IDAT"]
_PLACES = [rb"(?<![\w.])-?[\d.]+(e[+-]?\d+)?", rb"(?<![^\s,=:;\[({])[^\s,=:;\])}]+", rb"(?m)^[^\n]*\n"]


def _bytes(r: Random, data: bytes, other: bytes = b"") -> bytes:
    new = bytearray(data)
    for _ in range(r.choice((1, 1, 2, 4))):
        at = r.randrange(min(len(new), r.choice((600, 4096, LARGEST))) + 1)
        n, size = r.choice((1, 4, 8, 16, 32, 64)), r.choice((1, 2, 4, 8))
        some, flipped = new[at : at + n], bytes(byte ^ (1 << r.randrange(8)) for byte in new[at : at + 1])
        edge = (r.choice(_EDGES) % 256**size).to_bytes(size, r.choice(("little", "big")))
        ways = [(1, flipped), (size, edge)] * 2 + [(n, b""), (n, bytes(len(some))), (LARGEST, b"")]
        ways += [(0, r.randbytes(n)), (0, some * r.choice((1, 100)))]
        taken, given = r.choice([*ways, (LARGEST, other[r.randrange(len(other) + 1) :])])
        new[at : at + taken] = given
    return bytes(new)


def _text(r: Random, data: bytes, other: bytes = b"") -> bytes:
    """Changes numbers, fields and lines of a text, or of the text at the head of a file."""
    place, head = re.compile(r.choice(_PLACES)), min(len(data), r.choice((600, 4096, LARGEST)))
    one, two = (place.search(data, r.randrange(head)) or re.match(b"", b"") for _ in range(2))
    words = [b"\xff\xfe", b"\xed\xa0\x80", *re.findall(rb"[\w.+-]+", other[:999])]
    word = r.choice([*words, *(word.encode() for word in _WORDS)])
    same_size = word[: len(one[0])].ljust(len(one[0]))
    new = r.choice((word, word, same_size, same_size, one[0] + word, one[0] * 2, two[0], b""))
    return data[: one.start()] + new + data[one.end() :]


def _json(r: Random, data: bytes, other: bytes = b"") -> bytes:
    """Changes a key or a value in one line, and signs a protocol again."""
    lines = data.splitlines() if b"\n{" in data else [data]
    place = r.randrange(len(lines))
    holders: list[Any] = [root := [json.loads(lines[place])]]
    for holder in holders:
        parts = holder.values() if isinstance(holder, dict) else holder
        holders += [part for part in parts if isinstance(part, (dict, list)) and part]
    holder = r.choice(holders)
    key = r.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
    if (way := r.random()) < 0.2:
        del holder[key]
    elif way < 0.3 and isinstance(holder, dict):
        holder[r.choice(_WORDS)] = holder.pop(key)
    else:
        holder[key] = json.loads(json.dumps(r.choice((*_VALUES, *_WORDS, _WORDS, r.choice(holders)))))
    if "ProtocolDigest" in root[0]:
        root[0]["ProtocolDigest"] = digest(root[0]["Protocol"])
    lines[place] = json.dumps(root[0]).replace('"DEEP"', r.choice(("[", '{"a":')) * 100_000).encode()
    return b"\n".join(lines)


def _packed(r: Random, data: bytes, other: bytes = b"") -> bytes:
    """Changes content packed by gzip or zlib and packs it again, or appends very many zeros."""
    begins = (match.end() for match in re.finditer(rb"^|\n\r?\n|LOCAL\r?\n", data))
    start = next(at for at in begins if data[at : at + 2] in (b"\x1f\x8b", b"x\x9c", b"x\x01", b"x\xda"))
    pack = gzip.compress if data[start] == 0x1F else zlib.compress
    if r.random() < 0.01:
        return data + pack(bytes(1 << 24), 1) * 200  # 3.4 GB
    return data[:start] + pack(r.choice((_bytes, _text))(r, zlib.decompress(data[start:], 47), other), 1)


def _png(r: Random, data: bytes, other: bytes = b"") -> bytes:
    """Changes chunks, with right checksums."""
    chunks, at = [], 8
    while at < len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : end]))
        at = end + 4
    place = r.randrange(len(chunks))
    kind, part = chunks[place]
    long = b"a\0\0" + zlib.compress(bytes(r.choice((10, 10**7))), 1)
    packed = zlib.compress(_bytes(r, zlib.decompress(part), other)) if kind == b"IDAT" else part
    parts = (_bytes(r, part, other), _bytes(r, part, other), packed, long)
    chunks[place : place + r.randrange(2)] = [(r.choice((kind, kind, *_CHUNKS)), r.choice(parts))]
    summed = [(len(part), kind + part, zlib.crc32(kind + part)) for kind, part in chunks]
    return data[:8] + b"".join(struct.pack(f">I{n + 4}sI", n, part, crc) for n, part, crc in summed)


def _hdf5(r: Random, data: bytes, other: bytes = b"") -> bytes:
    """Changes attributes, datasets and links by the library, which writes right checksums."""

    def otherwise(old: Any) -> Any:
        text = old.decode() if isinstance(old, bytes) else old
        if isinstance(text, str) and text[:1] == "{" and r.random() < 0.8:
            return _json(r, text.encode()).decode()
        if isinstance(old, (np.ndarray, np.generic)) and old.dtype.kind != "O" and r.random() < 0.5:
            content = _bytes(r, old.tobytes()).ljust(old.nbytes)[: old.nbytes]
            return np.frombuffer(content, old.dtype).reshape(old.shape)
        return r.choice(_ARRAYS)

    with h5py.File(disk := io.BytesIO(data), "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        place, name, way = file[r.choice(["/", *names])].attrs, r.choice(names), r.randrange(16)
        if place and way < 9:
            old = place.pop(key := r.choice(sorted(place)))
            if way:
                place[key] = otherwise(old)
        else:
            value = file[name][()] if isinstance(file[name], h5py.Dataset) and file[name].size < 1e7 else None
            kind, shape = getattr(file[name], "dtype", "u1"), r.choice(((10**6,) * 3, (2000,) * 3, (2**40,)))
            del file[name]
            if way == 10:
                file[name] = r.choice(
                    (h5py.SoftLink("/"), h5py.SoftLink(name), h5py.ExternalLink("/dev/zero", "/"))
                )
            elif way == 11:
                file.create_dataset(name, shape, kind, chunks=(64,) * len(shape), compression="gzip")
            elif way == 12:
                file.create_dataset(name, (1 << 31,), kind, external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])
            elif way > 12 and value is not None:
                file[name] = otherwise(value)
    return disk.getvalue()


def _messages(r: Random, data: bytes, other: bytes = b"") -> bytes:
    """Changes heads and bodies of OpenIGTLink messages, with right lengths and checksums."""
    messages, at = [], 0
    while at < len(data):
        end = at + 58 + int.from_bytes(data[at + 42 : at + 50], "big")
        messages.append([data[at : at + 42], data[at + 58 : end]])
        at = end
    message, part = r.choice(messages), r.randrange(2)
    message[part] = _bytes(r, message[part], other)
    return b"".join(struct.pack(">42sQQ", head, len(body), crc64(body)) + body for head, body in messages)


_CHANGES: list[tuple[str, list[Callable[[Random, bytes, bytes], bytes]]]] = [
    (r"\.h5$", [_hdf5, _hdf5, _bytes]),
    (r"\.png$", [_png, _png, _bytes]),
    (r"\.jsonl?$", [_json, _json, _json, _text, _bytes]),
    (r"\.igtl$", [_messages, _messages, _bytes]),
    (r"\.(csv|tsv|toml|yaml)$", [_text, _text, _text, _bytes]),
    (r"", [_text, _bytes, _packed]),
]


def first(files: Files) -> str:
    """The file that is read; it may refer to the others."""
    return min(files, key=lambda name: (name.count("/"), name))


def changed(r: Random, files: Files, others: Files) -> Files:
    """An input like `files`, with parts of `others`."""
    new, steps = dict(files), []
    for _ in range(r.choice((1, 1, 1, 2, 3))):
        name = r.choice((first(new), r.choice(sorted(new))))
        steps.append((name, r.choice(next(ways for ending, ways in _CHANGES if re.search(ending, name)))))
    for name, way in sorted(steps, key=lambda step: step[1] is _bytes):  # _bytes last: it breaks structure
        with contextlib.suppress(Exception):  # the file may be broken already
            new[name] = way(r, new[name], r.choice(sorted(others.values())))[:LARGEST]
    if len(new) > 1 and r.random() < 0.05:
        del new[r.choice(sorted(new))]
    return new
