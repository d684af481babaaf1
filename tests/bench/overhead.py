"""What handing an item to a worker costs: threads, processes and a dask cluster, with and without a store.

    python tests/bench/overhead.py [--items 500] [--rounds 3]

Prints a table of microseconds an empty item, each the least of the rounds; the workers are warm. Two workers everywhere.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from burrlab.common.study import run_items

WORKERS, CHUNKS = 2, (1, 50)


@dataclass(frozen=True)
class Item:
    """As small as an item can be, with a seed."""

    seed: int


def nothing(item: Item) -> float:
    """The work: none."""
    return 0.5 * item.seed


@contextmanager
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(WORKERS) as pool:
        yield pool


@contextmanager
def processes() -> Iterator[Executor]:
    with ProcessPoolExecutor(WORKERS, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield pool


@contextmanager
def dask_cluster() -> Iterator[Executor]:
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
        Client(cluster) as client,
    ):
        yield client.get_executor()


KINDS: dict[str, Callable[[], contextmanager[Executor]]] = {
    "threads": threads,
    "processes": processes,
    "dask": dask_cluster,
}


def cost(executor: Executor, items: int, rounds: int, chunk: int, stored: bool) -> float:
    """Least time of an item [us]."""
    import overhead  # dask would send the functions of a script by value

    work = [overhead.Item(k) for k in range(items)]
    times = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(rounds):
            store = Path(folder) / f"{i}.jsonl" if stored else None
            start = time.perf_counter()
            run_items(overhead.nothing, work, executor=executor, chunk=chunk, store=store)
            times.append(time.perf_counter() - start)
    return 1e6 * min(times) / items


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--items", type=int, default=500)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}; {options.items} empty items"
    )
    print("| us an item | " + " | ".join(f"chunk {c}{s}" for s in ("", ", store") for c in CHUNKS) + " |")
    print("|---" * (1 + 2 * len(CHUNKS)) + "|")
    for name, kind in KINDS.items():
        with kind() as executor:
            cost(executor, 100, 1, 1, False)  # workers start and import
            row = [
                cost(executor, options.items, options.rounds, chunk, stored)
                for stored in (False, True)
                for chunk in CHUNKS
            ]
        print(f"| {name} | " + " | ".join(f"{value:.0f}" for value in row) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
