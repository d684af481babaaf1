"""Stubs of the vendors' libraries: libhd.c and libdhd.c, compiled, with two devices each that Python moves."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def compiled(name: str, folder: Path, options: tuple[str, ...] = ()) -> Path:
    """The library of `name`.c in the folder, with a state of its own."""
    file = folder / f"{name}{len(options)}.so"
    command = ["cc", "-std=gnu11", "-O1", "-fPIC", "-shared", *options, Path(__file__).with_name(f"{name}.c")]
    subprocess.run([*command, "-o", file, "-lm", "-pthread"], check=True)
    return file


class Stub:
    """The state of a stub's devices; the fields are those of `Device` in stub.h."""

    def __init__(self, file: Path) -> None:
        self.file = str(file)
        self._library = ctypes.CDLL(self.file)
        self._library.stub_get.restype = ctypes.c_double

    def set(self, device: int = 0, **fields: float) -> None:
        for name, value in fields.items():
            self._library.stub_set(name.encode(), device, ctypes.c_double(value))

    def get(self, name: str, device: int = 0) -> float:
        return float(self._library.stub_get(name.encode(), device))

    def force(self, device: int = 0) -> NDArray[np.float64]:
        """The force of the newest cycle [N]."""
        return np.array([self.get(name, device) for name in ("fx", "fy", "fz")])

    def log(self, device: int = 0) -> NDArray[np.float64]:
        """(cycles, 3): time [s], z as it was given [mm], force along z that then acts [N]; the newest."""
        table = np.empty((1 << 16, 3))
        return table[: self._library.stub_log(device, table.ctypes.data_as(ctypes.c_void_p))]
