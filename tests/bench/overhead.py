"""Cost of handing an item to a worker: threads, processes and a dask cluster; where a study saturates.

    python tests/bench/overhead.py [--items 500] [--rounds 3]
    python tests/bench/overhead.py --study 20000 --png docs/cluster.png

Prints a table of microseconds per empty item, the least of the rounds, with two warm workers. With `--study`
instead: studies of so many items on dask clusters whose scheduler and workers are processes of this machine, and
the growth of a store; `--png` draws items per second against workers.
"""

import asyncio
import logging
import multiprocessing
import os
import platform
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from options import options
from times import timed

import burrlab
from burrlab.common.figures import new_figure, tidy
from burrlab.common.study import Store, key_of, run_items
from burrlab.descent.sweep import SweepItem, run_item

WORKERS, CHUNKS = 2, (1, 50)
CLUSTERS, CROWD, TOGETHER = (2, 4, 8), 200, 100  # workers; those of a crowd share processes
SHORT, LONG = 0.01, 0.1  # sleep of an item on a cluster and in the crowd [s]
MODEL = (SHORT, LONG, 1.0, 10.0)


@dataclass(frozen=True)
class Item:
    """The smallest item with a seed, and a time to sleep [s]."""

    seed: int
    sleep: float = 0.0


def nothing(item: Item) -> float:
    """No work."""
    if item.sleep:
        time.sleep(item.sleep)
    return 0.5 * item.seed


def descent(seed: int) -> SweepItem:
    """A descent of 1.4 ms: bone at 2 N, R = 3 mm, on voxels of 0.6 mm."""
    return SweepItem(
        burrlab.Burr(3.0), burrlab.materials["bone"], 2.0, seed, 0.6, 1.0, "layer", True, None, None, 120.0
    )


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


def costs(items: int, rounds: int) -> None:
    print("| us an item | " + " | ".join(f"chunk {c}{s}" for s in ("", ", store") for c in CHUNKS) + " |")
    print("|---" * (1 + 2 * len(CHUNKS)) + "|")
    for name, kind in KINDS.items():
        with ExitStack() as stack:
            executor = kind(stack)
            cost(executor, 100, 1, 1, False)  # workers start and import
            row = [
                cost(executor, items, rounds, chunk, stored) for stored in (False, True) for chunk in CHUNKS
            ]
        print(f"| {name} | " + " | ".join(f"{value:.0f}" for value in row) + " |", flush=True)


def schedule(address: Any) -> None:
    """A process with a scheduler."""
    from distributed import Scheduler

    async def run() -> None:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        async with Scheduler(host="127.0.0.1", dashboard_address="127.0.0.1:0") as scheduler:
            address.put(scheduler.address)
            await scheduler.finished()

    asyncio.run(run())


def serve(address: str, count: int, folder: str) -> None:
    """A process with `count` workers of one thread; what each does by the clock is turned off."""
    import dask
    from distributed import Worker

    async def run() -> None:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        workers = [
            await Worker(address, nthreads=1, memory_limit=0, local_directory=folder) for _ in range(count)
        ]
        await asyncio.gather(*(worker.finished() for worker in workers))

    clock = {"distributed.worker.profile.enabled": False, "distributed.admin.system-monitor.interval": "60s"}
    with dask.config.set(clock):
        asyncio.run(run())


@dataclass(frozen=True)
class Run:
    """A study on a cluster: items and messages a second, CPU time a message [s] of client and scheduler."""

    workers: int
    seconds: float  # of an item that sleeps
    chunk: int | None
    rate: float
    messages: float
    client: float
    scheduler: float

    def row(self, what: str) -> str:
        share = f"{self.rate * self.seconds / self.workers:.0%}" if self.seconds else ""
        return (
            f"| {self.workers} | {what} | {self.chunk or 'default'} | {self.rate:.0f} | {share} | "
            f"{self.messages:.0f} | {1e3 * self.client:.2f} | {1e3 * self.scheduler:.2f} |"
        )


def studies(workers: int, together: int, cases: list[tuple[str, float, Callable, list]]) -> list[Run]:
    """Runs a fifth of every case with one item a message, and all with the default; prints a row for each."""
    import psutil
    from distributed import Client

    def used(process: Any) -> float:
        return sum(process.cpu_times()[:2])

    runs, queue = [], SPAWN.Queue()
    with tempfile.TemporaryDirectory() as folder:
        processes = [SPAWN.Process(target=schedule, args=(queue,))]
        processes[0].start()
        address = queue.get(timeout=60)
        for i in range(0, workers, together):
            arguments = (address, min(together, workers - i), folder)
            processes.append(SPAWN.Process(target=serve, args=arguments))
            processes[-1].start()
        pair = psutil.Process(), psutil.Process(processes[0].pid)
        with Client(address) as client:
            client.wait_for_workers(workers, timeout=300)
            executor, sent = client.get_executor(), [0]
            submit = executor.submit

            def count(*arguments: Any, **options: Any) -> Any:
                sent[0] += 1
                return submit(*arguments, **options)

            executor.submit = count
            for what, seconds, function, every in cases:
                run_items(function, every[: 4 * workers], executor=executor, chunk=1)  # workers import
                for chunk, items in ((1, every[: len(every) // 5]), (None, every)):
                    sent[0], before, start = 0, [used(p) for p in pair], time.perf_counter()
                    run_items(
                        function,
                        items,
                        executor=executor,
                        chunk=chunk,
                        store=Path(folder) / f"{len(runs)}.jsonl",
                    )
                    wall = time.perf_counter() - start
                    cpu = [(used(p) - b) / sent[0] for p, b in zip(pair, before, strict=True)]
                    runs.append(Run(workers, seconds, chunk, len(items) / wall, sent[0] / wall, *cpu))
                    print(runs[-1].row(what), flush=True)
            client.shutdown()
        for process in processes:
            process.join()
    return runs


def growth(count: int) -> None:
    """Prints what a store of `count` descents takes."""
    items, row = [descent(seed) for seed in range(count)], (0.48228, 0.5, 1.0, "ok", ())
    with tempfile.TemporaryDirectory() as folder:
        path, start = Path(folder) / "s.jsonl", time.perf_counter()
        store, keys = Store(path), [key_of(run_item, item) for item in items]
        key_times = time.perf_counter() - start
        times = [timed(store.add, key, row) for key in keys]
        opened, resumed = timed(Store, path), timed(run_items, run_item, items, store=path)
        first, last = (1e6 * np.mean(part) for part in (times[:1000], times[-1000:]))
        print(
            f"\nStore of {count} descents: {first:.0f} us a result in the first 1000, {last:.0f} in the last; "
            f"keys {1e6 * key_times / count:.0f} us each, opened in {opened:.2f} s, resumed in {resumed:.2f} s, "
            f"{path.stat().st_size / count:.0f} bytes a result"
        )


def study(count: int, png: str | None) -> None:
    import overhead

    print("| workers | item | chunk | items/s | of N/t | messages/s | client, ms a message | scheduler |")
    print("|---" * 8 + "|")
    cases = [
        ("descent", 0.0, run_item, [descent(k) for k in range(count)]),
        (f"sleep {SHORT:g} s", SHORT, overhead.nothing, [overhead.Item(k, SHORT) for k in range(count)]),
    ]
    runs = [run for workers in CLUSTERS for run in studies(workers, 1, cases)]
    long = [overhead.Item(k, LONG) for k in range(count)]
    runs += studies(CROWD, TOGETHER, [(f"sleep {LONG:g} s", LONG, overhead.nothing, long)])
    busiest = max(runs[-2].client, runs[-2].scheduler)  # of the crowd, one item a message [s]
    for seconds in MODEL:
        print(
            f"Model, items of {seconds:g} s: one a message saturates at {seconds / busiest:.0f} workers; "
            f"1000 need {1000 * busiest / seconds:.2g} items a message"
        )
    growth(count)
    if png is not None:
        draw(runs, busiest, png)


def draw(runs: list[Run], overhead: float, png: str) -> None:
    """Items per second against workers: measured, and the model min(N/t, chunk/overhead)."""
    figure = new_figure(4.6, 3.6)
    ax = tidy(figure.add_subplot())
    n = np.geomspace(1, 4000, 200)
    ax.plot(n, np.full(n.size, 1 / overhead), color="0.4", lw=1.6)
    for seconds, colour in zip(MODEL, ("#0072B2", "#009E73", "#D55E00", "#CC79A7"), strict=True):
        low = n[n / seconds < 1 / overhead]
        ax.plot(low, low / seconds, color=colour, lw=1.6, label=f"items of {seconds:g} s")
        ax.plot(n, n / seconds, color=colour, lw=1.2, ls=":")
        for run in (run for run in runs if run.seconds == seconds):
            ax.plot(run.workers, run.rate, "o", ms=6, mec=colour, mfc="white" if run.chunk else colour)
    ax.plot([], [], "o-", color="0.4", mfc="white", label="one item a message")
    ax.plot([], [], "o:", color="0.4", label="default chunk")
    ax.set(xscale="log", yscale="log", xlim=(1, 4000), ylim=(0.1, 20000))
    ax.set(xlabel="workers", ylabel="items per second [1/s]")
    ax.legend(fontsize=8, framealpha=1.0)
    figure.savefig(png, dpi=150)


def main() -> None:
    chosen = options(
        __doc__.splitlines()[0], items=500, rounds=3, study={"type": int, "metavar": "ITEMS"}, png={}
    )
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    if chosen.study is None:
        costs(chosen.items, chosen.rounds)
    else:
        study(chosen.study, chosen.png)


if __name__ == "__main__":
    main()
