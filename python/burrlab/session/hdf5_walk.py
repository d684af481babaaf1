"""What a reader of a bone or trace asks libhdf5 for, in a process of its own: a file that hangs or crashes it does so here."""

from __future__ import annotations

import contextlib
import itertools
import sys
from typing import Any

_MEMORY, _TIME = 4 << 30, 2  # that the process may have [bytes], and of the processor [s]


def walk(item: Any, depth: int = 0) -> None:
    """Attributes, members, and where each chunk lies; values of what is small."""
    dict(item.attrs.items())
    if hasattr(item, "keys"):
        for name in ["none", *itertools.islice(item, 1000 if depth < 4 else 0)]:
            if name in item:
                walk(item[name], depth + 1)
    elif item.chunks:
        item.id.chunk_iter(lambda chunk: None)
    elif item.shape is not None:
        item[:1] if item.shape else item[()]


if __name__ == "__main__":
    import h5py

    with contextlib.suppress(ImportError):
        import resource

        for what, most in ((resource.RLIMIT_AS, _MEMORY), (resource.RLIMIT_CPU, _TIME)):
            given = resource.getrlimit(what)[1]  # more than that nobody may set
            least = most if given == resource.RLIM_INFINITY else min(most, given)
            resource.setrlimit(what, (least, least))
    with contextlib.suppress(Exception), h5py.File(sys.argv[1], "r") as file:  # the reader says it better
        walk(file)
