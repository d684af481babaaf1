"""Results on disk, each under a key that says what made it, so that a study can go on where it was ended."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import math
import os
import reprlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from burrlab._core import Burr, Material, Shape, VoxelBone, __version__
from burrlab.json_text import UNREADABLE, parsed

#: What a study takes for a store: one, or the path of its file.
StorePath: TypeAlias = "Store | str | os.PathLike[str]"

#: Of keys and lines together: a store of another format is refused.
FORMAT = 1
_NAME = "burrlab store, format"
_HEADER = json.dumps({_NAME: FORMAT}).encode()
_SYNC = 1.0  # a result is forced to the disk unless the last one was less than this ago [s] (ours)
_NUMBERS = "biufc"  # kinds of NumPy's numbers that are nothing but their bytes

_PARTS: dict[type, tuple[str, ...]] = {
    Burr: ("radius",),
    Material: ("name", "c_e", "alpha", "shape", "source"),
    Shape: ("name",),
}


def _name(thing: Any) -> str:
    return f"{thing.__module__}.{thing.__qualname__}"


def _identity(value: Any) -> Any:
    """What tells `value` from every other one, as JSON can hold it: floats to the bit, types named."""
    if value is None or type(value) in (bool, int, str):
        return value
    if isinstance(value, np.float64) or type(value) is float:
        return ["float", float(value).hex()]
    if (type(value) is np.ndarray or isinstance(value, np.generic)) and value.dtype.kind in _NUMBERS:
        array = np.asarray(value)
        return ["array", array.dtype.str, list(array.shape), hashlib.sha256(array.tobytes()).hexdigest()]
    if type(value) in (tuple, list):
        return ["sequence", [_identity(part) for part in value]]
    if type(value) is dict and all(type(key) is str for key in value):
        return ["dict", [[key, _identity(value[key])] for key in sorted(value)]]
    if isinstance(value, VoxelBone):
        return ["bone", value.digest()]
    for kind, parts in _PARTS.items():
        if isinstance(value, kind):
            return [kind.__name__, [_identity(getattr(value, part)) for part in parts]]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [field.name for field in dataclasses.fields(value) if field.compare]
        return [_name(type(value)), [[name, _identity(getattr(value, name))] for name in fields]]
    raise TypeError(
        "item must be made of None, bool, int, float, str, tuples, lists, dicts with str keys, NumPy numbers and arrays, "
        f"burrs, materials, shapes, bones and dataclasses of these, got {value!r}"
    )


def key_of(function: Callable[..., Any], item: Any) -> str:
    """Key of a result: sha256 of the function's name, the item, the package version and the format of stores.

    Parameters
    ----------
    function : callable
        A function of a module. Its name counts, not what it does: after a change it needs another name or store.
    item : object
        Floats count to the bit; of a dataclass, the fields that take part in its comparison; of a bone, its digest.

    Raises
    ------
    TypeError
        If the function is none of a module, or the item holds something else than described there.

    Examples
    --------
    >>> key_of(round, 0.1) == key_of(round, 0.1), key_of(round, 0.1) == key_of(round, 0.1 + 2e-17)
    (True, False)
    """
    if "<" in getattr(function, "__qualname__", "<"):  # <lambda>, <locals>, functools.partial
        raise TypeError(
            f"function must be one of a module, which a store knows by its name, got {function!r}"
        )
    parts = [FORMAT, __version__, _name(function), _identity(item)]
    return hashlib.sha256(json.dumps(parts, separators=(",", ":")).encode()).hexdigest()


def _encode(value: Any) -> Any:
    if value is None or type(value) in (bool, int, str):
        return value
    if type(value) is float:
        return value if math.isfinite(value) else {"float": repr(value)}
    if type(value) is list:
        return [_encode(part) for part in value]
    if type(value) is tuple:
        return {"tuple": [_encode(part) for part in value]}
    if type(value) is dict and all(type(key) is str for key in value):
        return {"dict": {key: _encode(part) for key, part in value.items()}}
    if type(value) is np.ndarray or isinstance(value, np.generic):
        array = np.asarray(value)
        if array.dtype.kind in _NUMBERS:
            kind = "array" if type(value) is np.ndarray else "number"
            return {kind: [array.dtype.str, list(array.shape), base64.b64encode(array.tobytes()).decode()]}
    raise TypeError(
        "a result that is stored must be made of None, bool, int, float, str, tuples, lists, dicts with str keys, NumPy "
        f"numbers and arrays of numbers, got {value!r}"
    )


def _decode(value: Any) -> Any:
    if isinstance(value, list):
        return [_decode(part) for part in value]
    if not isinstance(value, dict):
        return value
    ((kind, content),) = value.items()
    if kind == "float":
        return float(content)
    if kind == "tuple":
        return tuple(_decode(part) for part in content)
    if kind == "dict":
        return {key: _decode(part) for key, part in content.items()}
    dtype, shape, data = content
    if kind not in ("array", "number") or np.dtype(dtype).kind not in _NUMBERS:
        raise ValueError(f"a result holds no {kind!r} of {dtype!r}")
    array = np.frombuffer(base64.b64decode(data), dtype).reshape(shape).copy()
    return array if kind == "array" else array[()]


class Store:
    """Results of a study in a file, one line of JSON each, only ever appended to.

    A line is written at once, so that a kill loses at most the result it came with, and that processes of one
    machine may write into the same file. What a process finds is what was there when it opened the store, and its own.

    Parameters
    ----------
    path : path-like
        Made if it does not exist.

    Raises
    ------
    ValueError
        If the file is no store, or one of another format.
    OSError
        If the file cannot be read and written.

    Notes
    -----
    A result may hold None, bool, int, float, str, tuples, lists, dicts with str keys, NumPy numbers and arrays of
    numbers; it comes back the same to the bit and type. Every write is the system's at once, so that it outlives the
    process; it is forced to the disk once a second at most, so that a power cut may cost the last second.
    A line that a kill has torn is left out; `repr` tells how many.

    Examples
    --------
    >>> import tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> store = Store(folder.name + "/study.jsonl")
    >>> store.add(key_of(round, 1.5), (0.1, float("nan")))
    >>> key_of(round, 1.5) in Store(store.path), Store(store.path).get(key_of(round, 1.5))
    (True, (0.1, nan))
    >>> folder.cleanup()
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._results: dict[str, str] = {}  # as JSON: what is handed out can be changed without harm
        self._torn = 0
        self._synced = -math.inf
        with self.path.open("ab") as file:  # also shows early that it can be written
            new = file.tell() == 0
        if new:
            self._append(_HEADER + b"\n")
        elif self._load(self.path.read_bytes()):
            self._append(b"\n" + _HEADER + b"\n")

    def _load(self, data: bytes) -> bool:
        """Reads the lines; True if there is nothing yet but a torn header."""
        lines = [line for line in data.split(b"\n") if line]
        while lines and lines[0] != _HEADER and _HEADER.startswith(lines[0]):
            self._torn += 1
            del lines[0]
        if not lines:
            return True
        try:
            found = json.loads(lines[0])[_NAME]
        except UNREADABLE:
            raise ValueError(
                f"store must be a file of burrlab results or a new one, got {self.path}"
            ) from None
        if found != FORMAT:
            raise ValueError(
                f"store must be of format {FORMAT}, got {self.path} of format {reprlib.repr(found)}"
            )
        for line in lines[1:]:
            if line == _HEADER:  # two processes made the file at once
                continue
            try:
                entry = json.loads(line)
                self._results[entry["key"]] = json.dumps(entry["result"])
            except UNREADABLE:
                self._torn += 1
        return False

    def _append(self, text: bytes) -> None:
        # Opened anew each time: on a network file system closing hands the text to the server.
        file = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            written = os.write(file, text)
            if written < len(text):
                raise OSError(f"store: {self.path} took {written} of {len(text)} bytes: is the disk full?")
            if time.monotonic() - self._synced > _SYNC:
                os.fsync(file)
                self._synced = time.monotonic()
        finally:
            os.close(file)

    def add(self, key: str, result: Any) -> None:
        """Appends a result; one that is there already is kept as it is.

        Raises
        ------
        TypeError
            If it holds a type that a store does not.
        OSError
            If it cannot be written.
        """
        if key in self._results:
            return
        text = json.dumps(_encode(result), allow_nan=False)
        # The newline comes first, so that what another process left torn stays a line of its own.
        self._append(f'\n{{"key": {json.dumps(key)}, "result": {text}}}'.encode())
        self._results[key] = text

    def get(self, key: str) -> Any:
        """The result under a key.

        Raises
        ------
        KeyError
            If there is none.
        ValueError
            If the file holds something else under it than `add` writes.
        """
        return parsed(str(self.path), self._results[key], "a store's result", _decode, finite=False)

    def __contains__(self, key: object) -> bool:
        return key in self._results

    def __len__(self) -> int:
        return len(self._results)

    def __repr__(self) -> str:
        torn = f", {self._torn} torn lines left out" if self._torn else ""
        return f"Store({str(self.path)!r}, {len(self)} results{torn})"
