"""Checks of arguments, and of the memory that a file or an object needs."""

import contextlib
import difflib
import importlib
import math
import operator
import os
import re
import reprlib
import zlib
from collections.abc import Iterable, Iterator, Sized
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray


def require_type(name: str, value: object, kind: type, example: str) -> None:
    """TypeError unless `value` is a `kind`."""
    if not isinstance(value, kind):
        raise TypeError(
            f"{name} must be a{'n' * (kind.__name__[0] in 'AEIOU')} {kind.__name__}, such as {example}, got {shown(value)}"
        )


def real(value: object, name: str) -> NDArray[np.float64]:
    """A copy in float64; ValueError for complex numbers, flags, bytes, 10**400, masked and anything not real."""
    if np.ma.is_masked(value):
        raise ValueError(f"{name} must have no masked numbers: leave them out, got {shown(value)}")
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        numbers = np.asarray(value)
        texts = numbers.dtype.kind == "O" and any(
            isinstance(element, str | bytes) for element in numbers.flat
        )
        if numbers.dtype.kind in "iufO" and not texts:
            return np.array(numbers, np.float64)
    raise ValueError(f"{name} must be of real numbers that a float holds, got {shown(value)}")


def scalar(value: object, name: str) -> float:
    """A number as a float; ValueError for a list and for anything not real."""
    number = real(value, name)
    if number.ndim:
        raise ValueError(f"{name} must be a single number, got {shown(value)}")
    return float(number)


def whole(name: str, value: object, end: int, end_text: str) -> int:
    """A whole number from 0 and below `end`; ValueError for anything else, also True and False."""
    try:
        number = -1 if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = -1
    refuse(not 0 <= number < end, f"{name} must be a whole number from 0 and below {end_text}, got {value!r}")
    return number


def check_positive(name: str, value: float) -> None:
    """TypeError unless it is a number, ValueError unless it is positive and finite."""
    if isinstance(value, bool | str | bytes) or not hasattr(value, "__float__") or np.ndim(value):
        raise TypeError(f"{name} must be a number, got {shown(value)}")
    refuse(not 0 < value < math.inf, f"{name} must be positive and finite, got {value}")


def check_same_length(**columns: Sized) -> None:
    """ValueError unless each has a value for one of the first."""
    (first, values), *others = columns.items()
    for name, column in others:
        refuse(
            len(column) != len(values),
            f"{name} must have {len(values)} values, one a {first}: got {len(column)}",
        )


def seed_or_new(seed: int | None) -> int:
    """The seed, or a random one for None; ValueError unless it is whole, from 0 and below 2^64."""
    drawn = np.random.SeedSequence().generate_state(1, np.uint64)[0] if seed is None else seed
    return whole("seed", drawn, 2**64, "2^64")


def nearest(name: object, names: Iterable[str]) -> str:
    """ "; did you mean 'bone'?" for a misspelt name; empty where none is near."""
    lower = {known.lower(): known for known in names}
    matches = difflib.get_close_matches(str(name).lower(), lower, 1)
    return f"; did you mean {lower[matches[0]]!r}?" if matches else ""


#: Most bytes that Deflate unpacks from one: two bits can stand for 258 bytes.
DEFLATE = 1032
#: Most data after the values in a packed stream [bytes] (ours).
_BEHIND = 1 << 20

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxstring, _SHORT.maxother = 2, 120, 120


def shown(value: object) -> str:
    """Short text of a value for a message; a large value costs no time."""
    text = " ".join(_SHORT.repr(value).split())  # an array has lines
    return text if len(text) <= 200 else f"{text[:200]}..."


def available_memory() -> float:
    """Free memory of the machine or its container [bytes]; infinity if unknown."""
    limits = [math.inf]
    with contextlib.suppress(OSError, ValueError, AttributeError):
        limits.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    with contextlib.suppress(OSError):
        memory = re.findall(r"^MemAvailable: *(\d+) kB", Path("/proc/meminfo").read_text(), re.MULTILINE)
        limits += [1024 * int(size) for size in memory]
    with contextlib.suppress(OSError, ValueError):  # "max" means no limit
        limits.append(int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return min(limits)


def check_memory(size: float, what: str) -> None:
    """ValueError if `size` [bytes] exceeds the available memory; `what` names the object."""
    refuse(
        size > (available := available_memory()),
        f"{what} needs {size / 1e9:.3g} GB of memory, and {available / 1e9:.3g} GB are there",
    )


def content_of(file: str | os.PathLike[str]) -> bytes:
    """All bytes of a file; ValueError if it needs more memory than is free, as one with holes may."""
    # a text takes five bytes for each until it is in lines; measured: 5.2
    check_memory(5.0 * os.path.getsize(file), f"{os.fspath(file)}: the file")
    return Path(file).read_bytes()


def check_packed(size: float, packed: float, name: str) -> None:
    """ValueError if `packed` bytes of Deflate cannot hold `size` bytes."""
    refuse(
        size > DEFLATE * packed,
        f"{name}: the file is cut short: {packed:.0f} packed bytes cannot hold {size} of values",
    )


def first_bytes(file: BinaryIO, size: int, packed: bool, name: str) -> tuple[NDArray[np.uint8], bytes]:
    """At most `size` unpacked bytes from the file's position, and the rest of the packed stream.

    A packed stream is zlib or gzip. Its checksum is checked, and the file's position is then at its end. ValueError
    if it is damaged, holds far more than `size`, cannot hold `size`, or needs more memory than the machine has.
    """
    left = max(os.fstat(file.fileno()).st_size - file.tell(), 0)
    if packed:
        check_packed(size, left, name)
    check_memory(size if packed else min(size, left), f"{name}: the file")
    if not packed:
        plain = np.empty(min(size, left), np.uint8)
        have = 0
        while count := file.readinto(plain[have : have + (1 << 26)]):  # type: ignore[attr-defined]
            have += count
        return plain[:have], b""
    values, have, rest = np.empty(size, np.uint8), 0, b""
    stream, chunk = zlib.decompressobj(32 + zlib.MAX_WBITS), b""
    while len(rest) <= _BEHIND:
        chunk = chunk or file.read(1 << 18)
        with amend_error(f"{name}: the compressed data is cut short or damaged (", ")", (zlib.error,)):
            piece = stream.decompress(chunk, 1 << 22)
        count = min(len(piece), size - have)
        values[have : have + count] = np.frombuffer(piece, np.uint8, count)
        have, rest = have + count, rest + piece[count:]
        if not stream.eof:
            refuse(
                not (chunk or piece), f"{name}: the compressed data is cut short or damaged (it has no end)"
            )
            chunk = stream.unconsumed_tail
            continue
        chunk = stream.unused_data + file.read(2)
        if not chunk.startswith(b"\x1f\x8b"):  # no further part; some gzip files have several
            file.seek(-len(chunk), os.SEEK_CUR)
            return values[:have], rest
        stream = zlib.decompressobj(32 + zlib.MAX_WBITS)
    raise ValueError(f"{name}: the compressed data must hold {size} bytes, as the header says, got far more")


def extra(module: str, what: str, name: str, usual_name: str = "") -> Any:
    """A module of an extra of this package; ImportError, which says how to get it, if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        needed = usual_name or module.partition(".")[0]
        raise ImportError(f"{what} needs {needed}: pip install 'burrlab[{name}]'") from None


def refuse(broken: object, sentence: str, error: type[BaseException] = ValueError) -> None:
    """ValueError, or another error, with this sentence if the rule is broken.

    The sentence is made in every call: to show an array takes a millisecond, so there write `if` and `raise`.
    """
    if broken:
        raise error(sentence)


@contextlib.contextmanager
def amend_error(
    before: str = "", after: str = "", kinds: tuple[type[Exception], ...] = (ValueError,)
) -> Iterator[None]:
    """An error of these kinds becomes a ValueError with words before and after its sentence."""
    try:
        yield
    except kinds as error:
        raise ValueError(f"{before}{error}{after}") from None
