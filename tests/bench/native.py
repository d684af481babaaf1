"""The benchmark's library (bench_lib.cpp) from Python: bones and burrs of the core, and the plain loop."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import c_char_p, c_double, c_int, c_int64, c_uint64, c_void_p
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from times import Numbers, Times

Levels = NDArray[np.uint8]


@dataclass(frozen=True)
class Burring:
    """Constant parameters of a scene's ticks.

    Parameters
    ----------
    spacing : float
        [mm]
    radius : float
        [mm]
    scheme : {"layer", "cell"}
    c_e : float
        [N/mm^2]
    alpha : float
        [1/ms]
    dt : float
        [ms]
    seed : int
    origin : (x, y, z)
        [mm]
    """

    spacing: float
    radius: float
    scheme: str = "layer"
    c_e: float = 2.145
    alpha: float = 0.087
    dt: float = 1.0
    seed: int = 1
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)


def address(array: NDArray[np.generic] | None) -> int | None:
    """Address of a C-contiguous array."""
    if array is None:
        return None
    if not array.flags.c_contiguous:
        raise ValueError("array must be C-contiguous")
    return array.ctypes.data


class Native:
    """The loaded library."""

    def __init__(self, path: Path) -> None:
        library = ctypes.CDLL(str(path))
        for name, result, arguments in (
            ("bench_error", c_char_p, []),
            ("bench_cpu_paths", c_char_p, []),
            ("bench_compiler", c_char_p, []),
            ("bench_flags", c_char_p, []),
            ("bench_depth_table", None, [c_void_p]),
            ("bench_bandwidth", c_double, [c_int64, c_int, c_int]),
            ("core_new", c_void_p, [c_void_p, c_void_p, c_void_p, c_double, c_void_p, c_double, c_double, c_double,
                                    c_int, c_uint64, c_char_p, c_uint64]),
            ("core_clone", c_void_p, [c_void_p, c_char_p]),
            ("core_free", None, [c_void_p]),
            ("core_set_tissues", c_int, [c_void_p, c_void_p, c_int, c_int]),
            ("core_reset", c_int, [c_void_p]),
            ("core_run", c_int, [c_void_p, c_void_p, c_int64, c_double, c_int64, c_void_p, c_void_p, c_void_p]),
            ("core_density", c_int, [c_void_p, c_void_p]),
            ("core_digest", c_char_p, [c_void_p]),
            ("core_hierarchy_bytes", c_int64, [c_void_p]),
            ("plain_run", c_int, [c_void_p, c_void_p, c_void_p, c_double, c_void_p, c_double, c_int, c_uint64,
                                  c_uint64, c_double, c_void_p, c_int64, c_void_p, c_void_p, c_void_p]),
        ):  # fmt: skip
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        self.library = library
        self.cpu_paths: list[str] = library.bench_cpu_paths().decode().split(",")
        self.depth_table = np.empty((25, 41), dtype=np.float32)  # G(e, tau) of order 1
        library.bench_depth_table(address(self.depth_table))

    def check(self, done: int | None) -> int:
        """The result of a call, or its error."""
        if done is None or done < 0:
            raise RuntimeError(self.library.bench_error().decode())
        return done

    def bandwidth(self, size: int, *, copy: bool) -> float:
        """Best of some passes over `size` bytes [GB/s]."""
        return 1e-9 * float(self.library.bench_bandwidth(size, 3, copy))

    def plain_run(
        self, q: Levels, p: Levels, burring: Burring, tick: int, centers: Numbers
    ) -> tuple[Times, NDArray[np.int64]]:
        """Times and sums (n, 5) of ticks of the plain loop, one per centre; erodes `q`."""
        shape, origin = np.array(q.shape, dtype=np.int64), np.array(burring.origin)
        times, sums = Times.empty(len(centers)), np.empty((len(centers), 5), dtype=np.int64)
        self.check(
            self.library.plain_run(
                address(shape), address(q), address(p), burring.spacing, address(origin), burring.radius,
                burring.scheme == "layer", burring.seed, tick, burring.alpha * burring.dt,
                address(centers), len(centers), address(times.seconds), address(times.interrupted), address(sums),
            )
        )  # fmt: skip
        return times, sums


class Core:
    """A bone of the core with one burr on one CPU path."""

    def __init__(self, native: Native, handle: int | None, shape: Sequence[int], burring: Burring) -> None:
        self.native, self.library, self.shape, self.burring = native, native.library, tuple(shape), burring
        self.handle = native.check(handle)

    @classmethod
    def of(
        cls, native: Native, p: Levels, burring: Burring, path: str, *, q: Levels | None = None, tick: int = 0
    ) -> Core:
        """A bone of pristine levels, with present ones where these differ."""
        shape, origin = np.array(p.shape, dtype=np.int64), np.array(burring.origin)
        handle = native.library.core_new(
            address(shape), address(p), address(q), burring.spacing, address(origin), burring.radius,
            burring.c_e, burring.alpha, burring.scheme == "layer", burring.seed, path.encode(), tick,
        )  # fmt: skip
        return cls(native, handle, p.shape, burring)

    def clone(self, path: str) -> Core:
        """The same state on another CPU path."""
        return Core(
            self.native, self.library.core_clone(self.handle, path.encode()), self.shape, self.burring
        )

    def __del__(self) -> None:
        if hasattr(self, "handle"):
            self.library.core_free(self.handle)

    def run(self, centers: Numbers, *, batch: int = 1, moments: Numbers | None = None) -> Times:
        """Times of ticks, one per centre, as means over `batch`; m0 and m1 of each go to `moments` (n, 4)."""
        if len(centers) % batch:
            raise ValueError("the number of ticks must be a multiple of batch")
        times, centers = Times.empty(len(centers) // batch), np.ascontiguousarray(centers)
        self.native.check(
            self.library.core_run(
                self.handle, address(centers), len(centers), self.burring.dt, batch,
                address(times.seconds), address(times.interrupted), address(moments),
            )
        )  # fmt: skip
        return times

    def run_fresh(self, centers: Numbers) -> Times:
        """Times of ticks that each begin with the bone as loaded."""
        times = []
        for center in centers:
            self.native.check(self.library.core_reset(self.handle))
            times.append(self.run(center[None]))
        return Times.join(times)

    def set_tissues(self, numbers: Levels, count: int, *, watched: int = 0) -> None:
        """Sets `count` tissues of different c_e and the burr's alpha; ticks query distances to the first `watched`."""
        self.native.check(self.library.core_set_tissues(self.handle, address(numbers), count, watched))

    def density(self) -> Levels:
        """Dense copy of the present levels."""
        q = np.empty(self.shape, dtype=np.uint8)
        self.native.check(self.library.core_density(self.handle, address(q)))
        return q

    @property
    def digest(self) -> str:
        return self.library.core_digest(self.handle).decode()

    @property
    def hierarchy_bytes(self) -> int:
        return self.library.core_hierarchy_bytes(self.handle)
