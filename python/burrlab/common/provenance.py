"""Provenance of results."""

import platform
from typing import Any

import numpy as np

import burrlab._core as _core


def provenance(**parameters: Any) -> dict[str, Any]:
    """Versions, machine type and CPU path, followed by the given parameters.

    Examples
    --------
    >>> sorted(provenance(seed=1))
    ['burrlab', 'cpu_path', 'machine', 'numpy', 'python', 'seed']
    """
    return {
        "burrlab": _core.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": platform.machine(),
        "cpu_path": _core.cpu_path(),
        **parameters,
    }
