"""A DICOM file taken apart into its data elements, and put together again with some of them changed.

Encoding after DICOM PS3.5, chapter 7 and annex A; file meta information after PS3.10, chapter 7.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

IMPLICIT, EXPLICIT = "1.2.840.10008.1.2", "1.2.840.10008.1.2.1"
_DEFLATED, _BIG = "1.2.840.10008.1.2.1.99", "1.2.840.10008.1.2.2"
PIXELS = 0x7FE00010
_META, _SYNTAX, _INSTANCE = 0x00020000, 0x00020010, 0x00020003
_LONG = (b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV")
_ITEM, _ITEM_END, _SEQUENCE_END = 0xFFFEE000, 0xFFFEE00D, 0xFFFEE0DD
_OPEN = 0xFFFFFFFF  # a length that is not told


@dataclass(frozen=True)
class Element:
    """Its type (VR, empty where the file does not say it), and the bytes of the whole element and of its value."""

    kind: bytes
    whole: bytes
    value: bytes


@dataclass(frozen=True)
class Elements:
    """Of a file.

    Attributes
    ----------
    meta, data : dict of int to Element
        By tag, 0xGGGGEEEE: file meta information, and the data set without its group lengths.
    syntax : str
        UID of the transfer syntax; of a deflated data set, that of the inflated one.
    """

    meta: dict[int, Element]
    data: dict[int, Element]
    syntax: str

    @property
    def order(self) -> str:
        """Of the bytes of numbers: "<" or ">"."""
        return ">" if self.syntax == _BIG else "<"

    @property
    def packed(self) -> bool:
        """Whether the pixels are compressed."""
        return self.syntax not in (IMPLICIT, EXPLICIT, _BIG)

    @property
    def unpacked(self) -> str:
        """The transfer syntax of the file with its pixels not compressed."""
        return EXPLICIT if self.packed else self.syntax

    def text(self, tag: int) -> str:
        """Value of a text element; empty where it is not there."""
        found = self.data.get(tag)
        return "" if found is None else found.value.decode("latin-1").strip(" \0")

    def number(self, tag: int, default: float) -> float:
        """The one number of a text element; NaN where it is none."""
        try:
            return float(text) if (text := self.text(tag)) else default
        except ValueError:
            return math.nan

    def short(self, tag: int) -> int:
        """The one whole number of a binary element (US); -1 where it is not there."""
        found = self.data.get(tag)
        if found is None or len(found.value) != 2:
            return -1
        return int.from_bytes(found.value, "big" if self.order == ">" else "little")

    def changed(self, values: dict[int, tuple[bytes, bytes] | None], instance: str) -> bytes:
        """The file with other elements (type and value; None takes one out), under another SOPInstanceUID; pixels not packed."""
        syntax = self.unpacked
        meta = {tag: element.whole for tag, element in self.meta.items() if tag != _META}
        for tag, uid in ((_SYNTAX, syntax), (_INSTANCE, instance)):
            meta[tag] = encoded(tag, b"UI", padded(uid, b"\0"), EXPLICIT)
        data = {tag: element.whole for tag, element in self.data.items()}
        for tag, pair in values.items():
            data.pop(tag, None)
            if pair is not None:
                data[tag] = encoded(tag, *pair, syntax)
        head = b"".join(meta[tag] for tag in sorted(meta))
        size = encoded(_META, b"UL", len(head).to_bytes(4, "little"), EXPLICIT)
        return bytes(128) + b"DICM" + size + head + b"".join(data[tag] for tag in sorted(data))


def elements_of(content: bytes, name: str) -> Elements:
    """Takes a file apart; ValueError where it has no file meta information, or its elements do not fill it."""
    if content[128:132] != b"DICM":
        raise ValueError(f"{name}: the DICOM file has no file meta information, so its header cannot be kept")
    try:
        meta: dict[int, Element] = {}
        at = 132
        while content[at : at + 2] == b"\x02\0":
            tag, element, at = _element(content, at, "<", True)
            meta[tag] = element
        syntax = meta[_SYNTAX].value.decode("ascii").strip(" \0")
        body = content[at:]
        if syntax == _DEFLATED:
            body, syntax = zlib.decompressobj(-zlib.MAX_WBITS).decompress(body), EXPLICIT
        order, data, at = ">" if syntax == _BIG else "<", {}, 0
        while at < len(body):
            tag, element, at = _element(body, at, order, syntax != IMPLICIT)
            if tag & 0xFFFF:
                data[tag] = element
    except (ValueError, KeyError, RecursionError, zlib.error):
        raise ValueError(
            f"{name}: the DICOM file cannot be taken apart, so its header cannot be kept"
        ) from None
    return Elements(meta, data, syntax)


def encoded(tag: int, kind: bytes, value: bytes, syntax: str) -> bytes:
    """An element's bytes; the value must have an even length."""
    assert len(value) % 2 == 0
    order = "big" if syntax == _BIG else "little"
    head = (tag >> 16).to_bytes(2, order) + (tag & 0xFFFF).to_bytes(2, order)  # type: ignore[arg-type]
    if syntax == IMPLICIT or not kind:  # items have no type
        return head + len(value).to_bytes(4, order) + value  # type: ignore[arg-type]
    if kind in _LONG:
        return head + kind + b"\0\0" + len(value).to_bytes(4, order) + value  # type: ignore[arg-type]
    return head + kind + len(value).to_bytes(2, order) + value  # type: ignore[arg-type]


def padded(text: str, end: bytes = b" ") -> bytes:
    """Text of an even length, as `Elements.text` reads it: bytes that are no ASCII stay as they are."""
    return text.encode("latin-1") + end * (len(text) % 2)


def _number(content: bytes, at: int, size: int, order: str) -> int:
    if at + size > len(content):
        raise ValueError("ends in the middle of an element")
    return int.from_bytes(content[at : at + size], "big" if order == ">" else "little")


def _tag(content: bytes, at: int, order: str) -> int:
    return _number(content, at, 2, order) << 16 | _number(content, at + 2, 2, order)


def _element(content: bytes, at: int, order: str, explicit: bool) -> tuple[int, Element, int]:
    """Tag, element, and where the next begins."""
    tag, kind, size = _tag(content, at, order), b"", 4
    start = at + 4
    if explicit and tag >> 16 != 0xFFFE:
        kind = content[start : start + 2]
        if not (len(kind) == 2 and kind.isalpha() and kind.isupper()):
            raise ValueError("no type")
        start, size = (start + 4, 4) if kind in _LONG else (start + 2, 2)
    length = _number(content, start, size, order)
    start += size
    unsaid = size == 4 and length == _OPEN
    end = _end(content, start, order, explicit and kind != b"UN") if unsaid else start + length
    if end > len(content):
        raise ValueError("ends in the middle of an element")
    return tag, Element(kind, content[at:end], content[start:end]), end


def _end(content: bytes, at: int, order: str, explicit: bool) -> int:
    """Where a sequence without a length ends, its delimiter included."""
    while True:
        tag, length = _tag(content, at, order), _number(content, at + 4, 4, order)
        at += 8
        if tag == _SEQUENCE_END:
            return at
        if tag != _ITEM:
            raise ValueError("no item")
        if length != _OPEN:
            at += length
            continue
        while _tag(content, at, order) != _ITEM_END:
            _, _, at = _element(content, at, order, explicit)
        at += 8
