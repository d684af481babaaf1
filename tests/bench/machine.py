"""What was measured on."""

from __future__ import annotations

import datetime
import os
import platform
from pathlib import Path
from typing import Any

import numba
import numpy as np
from native import Native

import burrlab


def cpu_model() -> str:
    """As the system names it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown"
    )


def machine(native: Native) -> dict[str, Any]:
    """Processor, compiler and versions."""
    return {
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "cpu_paths": native.cpu_paths,
        "compiler": native.compiler,
        "flags": native.flags,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "burrlab": burrlab.__version__,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "clock_ns": 1e9 * native.clock(),
    }


def pin() -> set[int] | None:
    """Keeps this process on one core, where the system can; returns where it may run otherwise."""
    if not hasattr(os, "sched_setaffinity"):
        return None
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    return before


def unpin(before: set[int] | None) -> None:
    if before is not None:
        os.sched_setaffinity(0, before)
