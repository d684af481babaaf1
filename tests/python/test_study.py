"""Studies: order, executors, interrupts, resuming."""

import contextlib
import gc
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, field
from unittest.mock import Mock

import numpy as np
import pytest
from replica_scenes import soon

from burrlab.common.study import Store, StudyInterrupted, cancel_event, run_items


@dataclass(frozen=True)
class Item:
    number: int
    # Folder of the file of calls, and of a file "poison" that makes item 7 fail; stores ignore it.
    folder: str = field(default="", compare=False)
    how: str = field(default="", compare=False)


def work(item: Item) -> tuple[int, float]:
    """Counts its calls in a file, and draws from the item's seed."""
    if item.folder:
        with open(f"{item.folder}/calls", "a") as file:
            file.write(f"{item.number}\n")
        if item.number == 7 and os.path.exists(f"{item.folder}/poison"):
            if item.how == "kill":
                soon(lambda: len(Store(f"{item.folder}/s.jsonl")) >= 6, 30.0)
                os.kill(os.getpid(), signal.SIGKILL)
            raise ZeroDivisionError("item seven")
    return item.number, float(np.random.default_rng(item.number).normal())


REACHED = threading.Event()


def wait_for_the_end(number: int) -> int:
    """Waits until the study is over, except for the first three items."""
    if number >= 3:
        REACHED.set()
        assert cancel_event().wait(60)
        raise KeyboardInterrupt
    return number


def calls(folder) -> list[int]:
    file = folder / "calls"
    return [int(line) for line in file.read_text().split()] if file.exists() else []


def assert_goes_on(function, folder, count, done, **options) -> None:
    """Asserts that a study of which so many items are done runs those that are missing, each once."""
    folder.mkdir()
    items = [Item(i, str(folder)) for i in range(count)]
    assert run_items(function, items, **options) == [work(Item(i)) for i in range(count)]
    assert len(calls(folder)) == len(set(calls(folder))) == count - done


def processes(n: int = 2) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(n, mp_context=multiprocessing.get_context("spawn"))


@pytest.fixture(scope="module")
def pool():
    with processes() as pool:
        yield pool


@pytest.fixture
def when_reached():
    """Calls a function when an item waits for the end of its study."""
    gc.collect()  # Python drops an exception, also Ctrl-C's, in what dies
    REACHED.clear()
    threads = []

    def later(act, *arguments):
        def run():
            if REACHED.wait(60):
                time.sleep(0.2)  # the first items finish
                act(*arguments)

        threads.append(threading.Thread(target=run))
        threads[0].start()

    yield later
    threads[0].join()


@pytest.mark.parametrize(("chunk", "workers"), [(1, None), (7, 3), (1000, 1)])
def test_results_are_in_item_order_whatever_the_workers(chunk, workers):
    items = [Item(i) for i in range(40)]
    expected = [work(item) for item in items]
    with contextlib.nullcontext() if workers is None else ThreadPoolExecutor(workers) as pool:
        assert run_items(work, items, executor=pool, chunk=chunk) == expected


def at_once(function, *arguments):
    """A message that is done as it is submitted."""
    future = Future()
    future.set_result(function(*arguments))
    return future


def test_short_items_are_sent_many_at_once(monkeypatch):
    """A quarter of a worker's share at most; long items go one by one, and threads get no more at once."""
    here, items = Mock(spec=Executor, submit=Mock(side_effect=at_once)), range(-500, 500)
    clock, real = itertools.count(), time.perf_counter
    monkeypatch.setattr(
        time, "perf_counter", lambda: 1e-6 * next(clock)
    )  # a busy machine's items may be long
    assert run_items(abs, items, executor=here) == [abs(i) for i in items]
    assert run_items(abs, items, executor=here, chunk=600) == [abs(i) for i in items]
    monkeypatch.setattr(time, "perf_counter", real)
    run_items(slowly, [Item(i) for i in range(20)], executor=here)
    sizes = [len(message.args[2]) for message in here.submit.call_args_list]
    assert sizes[:7] == [1, 250, 250, 250, 249, 600, 400]
    assert max(sizes[7:]) <= 2, "20 ms each"


def test_what_is_under_way_is_bounded(monkeypatch):
    def ahead(i):
        while i == 0 and pool.submit.call_count < 5:
            time.sleep(0.001)
        time.sleep(0.005)
        return pool.submit.call_count - i

    monkeypatch.setattr("burrlab.common.study._AHEAD", 5)
    with ThreadPoolExecutor(1) as pool:
        monkeypatch.setattr(pool, "submit", Mock(wraps=pool.submit))
        assert max(run_items(ahead, range(40), executor=pool)) == 5


def test_processes_give_the_same(tmp_path, pool):
    items = [Item(i) for i in range(20)]
    expected = [work(item) for item in items]
    assert run_items(work, items, executor=pool) == expected
    assert run_items(work, items, executor=pool, chunk=6, store=tmp_path / "s.jsonl") == expected
    assert run_items(work, items, store=tmp_path / "s.jsonl") == expected
    assert run_items(work, []) == []


def test_progress_counts_what_the_store_has(tmp_path):
    seen = []
    items = [Item(i, str(tmp_path)) for i in range(6)]
    run_items(work, items[:4], store=tmp_path / "s.jsonl")
    run_items(work, items, store=tmp_path / "s.jsonl", progress=lambda *of: seen.append(of))
    assert seen == [(i, 6) for i in range(1, 7)]
    assert sorted(calls(tmp_path)) == list(range(6)), "none twice"


def test_another_function_or_item_is_run(tmp_path):
    store = Store(tmp_path / "s.jsonl")
    run_items(abs, [-1.0], store=store)
    assert run_items(round, [-1.0], store=store) == [-1]
    assert run_items(abs, [-1.5], store=store) == [1.5]
    assert len(store) == 3


@pytest.mark.parametrize("chunk", [1, 5])
def test_an_error_of_the_function_passes_and_what_is_done_is_kept(tmp_path, chunk):
    (tmp_path / "poison").touch()
    items = [Item(i, str(tmp_path)) for i in range(20)]
    store = Store(tmp_path / "s.jsonl")
    with ThreadPoolExecutor(1) as pool, pytest.raises(ZeroDivisionError, match=r"^item seven$"):
        run_items(work, items, executor=pool, store=store, chunk=chunk)
    assert len(store) >= 7, "the part of the chunk before it too"
    done = len(store)
    (tmp_path / "poison").unlink()
    before = len(calls(tmp_path))
    assert run_items(work, iter(items), store=store) == [work(Item(i)) for i in range(20)]
    assert len(calls(tmp_path)) - before == 20 - done


def test_an_error_in_another_process_tells_where(tmp_path, pool):
    (tmp_path / "poison").touch()
    with pytest.raises(ZeroDivisionError, match="item seven") as caught:
        run_items(work, [Item(7, str(tmp_path))], executor=pool)
    assert any("in work" in note for note in caught.value.__notes__)


def test_a_worker_that_is_killed_loses_nothing_finished(tmp_path):
    (tmp_path / "poison").touch()
    items = [Item(i, str(tmp_path), "kill") for i in range(30)]
    path = tmp_path / "s.jsonl"
    with processes() as pool, pytest.raises(StudyInterrupted) as caught:
        run_items(work, items, executor=pool, store=path, chunk=2)
    done = len(Store(path))
    assert done >= 6
    message = (
        rf"^the executor died after {done} of 30 items \(BrokenProcessPool: .*\); what was finished is in "
    )
    assert caught.match(message)
    assert caught.match(r"s\.jsonl, run again with the same store to go on$")
    assert_goes_on(work, tmp_path / "again", 30, done, store=path)


def test_an_executor_that_is_shut_down():
    with ThreadPoolExecutor(1) as pool:
        pool.shutdown()
        with pytest.raises(
            StudyInterrupted, match=r"died after 0 of 1 items \(RuntimeError: cannot schedule .*with a store"
        ):
            run_items(work, [Item(1)], executor=pool)


def test_an_executor_that_is_shut_down_in_mid_study(tmp_path):
    store = Store(tmp_path / "s.jsonl")
    with (
        ThreadPoolExecutor(1) as pool,
        pytest.raises(StudyInterrupted, match=r"died after \d+ of 50 items \(CancelledError\)"),
    ):
        run_items(
            slowly, [Item(i) for i in range(50)], executor=pool, store=store,
            progress=lambda done, total: pool.shutdown(wait=False, cancel_futures=True),
        )  # fmt: skip
    assert len(store) >= 1


@pytest.mark.parametrize(("chunk", "workers"), [(1, None), (4, None), (1, 2)])
def test_ctrl_c_ends_the_threads_and_keeps_what_is_done(tmp_path, when_reached, chunk, workers):
    """A real signal arrives while all work without end; of a chunk, what was done then is kept. Threads of the caller
    are told to end too: the exit of their executor waits for them."""
    store, before = Store(tmp_path / "s.jsonl"), threading.active_count()
    when_reached(os.kill, os.getpid(), signal.SIGINT)
    with (
        contextlib.nullcontext() if workers is None else ThreadPoolExecutor(workers) as pool,
        pytest.raises(KeyboardInterrupt),
    ):
        run_items(wait_for_the_end, range(1000), executor=pool, store=store, chunk=chunk)
    assert len(store) == 3
    assert threading.active_count() <= before + 1, "the threads made there are gone"


def slowly(item: Item) -> tuple[int, float]:
    time.sleep(0.02)
    return work(item)


KILLED = """
import sys
from test_study import Item, slowly
from burrlab.common.study import run_items
if __name__ == "__main__":
    run_items(slowly, [Item(i, sys.argv[1]) for i in range(100)], store=sys.argv[1] + "/s.jsonl")
"""


def test_a_study_that_is_killed_goes_on(tmp_path):
    """SIGKILL ends the process, as a time limit, an empty battery or a full memory would."""
    path = tmp_path / "s.jsonl"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([p for p in sys.path if p])}
    with subprocess.Popen([sys.executable, "-c", KILLED, tmp_path], env=environment) as process:
        soon(lambda: len(calls(tmp_path)) >= 20, 60.0)
        process.kill()
    done, begun = len(Store(path)), len(calls(tmp_path))
    assert 0 < done <= begun < 100
    items = [Item(i, str(tmp_path)) for i in range(100)]
    assert run_items(slowly, items, store=path, chunk=10) == [work(Item(i)) for i in range(100)]
    assert len(calls(tmp_path)) - begun == 100 - done


@pytest.mark.parametrize(
    ("function", "items", "options", "error", "told"),
    [
        (work, [Item(1)], {"executor": "threads"}, TypeError, r"of a dask client its client\.get_executor\(\), got 'threads'"),
        *((work, [Item(1)], {"chunk": chunk}, ValueError,
            f"chunk must be a whole number from 1, got {chunk}") for chunk in (0, 1.5)),
        (complex, [1, 2], {"store": "s.jsonl"}, TypeError, "a result that is stored"),
        (complex, [object()], {"store": "s.jsonl"}, TypeError, "item must be made of"),
        (work, [Item(1)], {"store": __file__}, ValueError, "store must be a file of burrlab results"),
    ],
)  # fmt: skip
def test_what_is_refused(here, function, items, options, error, told):
    with pytest.raises(error, match=told):
        run_items(function, items, **options)
