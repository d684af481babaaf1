"""The machine of a measurement."""

import datetime
import os
import platform
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
import numpy as np
from native import Native

import burrlab


def cpu_model() -> str:
    """Name of the processor."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or "unknown"
    named = re.search(r"^model name.*?:(.*)", text, re.MULTILINE)
    return named[1].strip() if named else "unknown"


def machine(native: Native) -> dict[str, Any]:
    """Processor, compiler and versions."""
    return {
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "cpu_paths": native.cpu_paths,
        "compiler": native.library.bench_compiler().decode(),
        "flags": native.library.bench_flags().decode(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "burrlab": burrlab.__version__,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "clock_ns": 1e9 * native.library.bench_clock(1000),  # cost of reading the clock
    }


@contextmanager
def on_one_core() -> Iterator[None]:
    """Keeps this process on one core, if the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    yield
    os.sched_setaffinity(0, before)
