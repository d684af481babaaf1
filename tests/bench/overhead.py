"""Cost of handing an item to a worker: threads, processes and a dask cluster.

    python tests/bench/overhead.py [--items 500] [--rounds 3]

Prints a table of microseconds per empty item, the least of the rounds, with two warm workers.
"""

import multiprocessing
import os
import platform
import tempfile
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from options import options
from times import timed

from burrlab.common.study import run_items

WORKERS, CHUNKS = 2, (1, 50)


@dataclass(frozen=True)
class Item:
    """The smallest item with a seed."""

    seed: int


def nothing(item: Item) -> float:
    """No work."""
    return 0.5 * item.seed


def dask_cluster(stack: ExitStack) -> Executor:
    from distributed import Client, LocalCluster

    cluster = LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address="127.0.0.1:0")
    return stack.enter_context(Client(stack.enter_context(cluster))).get_executor()


SPAWN = multiprocessing.get_context("spawn")
KINDS: dict[str, Callable[[ExitStack], Executor]] = {
    "threads": lambda stack: stack.enter_context(ThreadPoolExecutor(WORKERS)),
    "processes": lambda stack: stack.enter_context(ProcessPoolExecutor(WORKERS, mp_context=SPAWN)),
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
            times.append(
                timed(run_items, overhead.nothing, work, executor=executor, chunk=chunk, store=store)
            )
    return 1e6 * min(times) / items


def main() -> None:
    chosen = options(__doc__, items=500, rounds=3)
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    print("| us an item | " + " | ".join(f"chunk {c}{s}" for s in ("", ", store") for c in CHUNKS) + " |")
    print("|---" * (1 + 2 * len(CHUNKS)) + "|")
    for name, kind in KINDS.items():
        with ExitStack() as stack:
            executor = kind(stack)
            cost(executor, 100, 1, 1, False)  # workers start and import
            row = [
                cost(executor, chosen.items, chosen.rounds, chunk, stored)
                for stored in (False, True)
                for chunk in CHUNKS
            ]
        print(f"| {name} | " + " | ".join(f"{value:.0f}" for value in row) + " |", flush=True)


if __name__ == "__main__":
    main()
