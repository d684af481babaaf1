"""Studies on a dask cluster: real worker processes on this machine, some of them killed."""

import os
import re
import signal
from unittest.mock import Mock

import pytest
from session_scenes import refused
from test_study import Item, assert_goes_on, calls, slowly, work

from burrlab.common.study import Store, StudyInterrupted, run_items

distributed = pytest.importorskip("distributed", reason="dask is not installed (extra cluster)")
dask = pytest.importorskip("dask")


@pytest.fixture(scope="module")
def client():
    # A free port for the dashboard: the default port warns if another cluster has it.
    with (
        dask.config.set(
            {"distributed.scheduler.allowed-failures": 1, "distributed.worker.profile.enabled": False}
        ),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@pytest.fixture
def executor(client):
    """Waits for two workers: one that an earlier test killed comes back."""
    client.wait_for_workers(2, timeout=60)
    return client.get_executor()


ITEMS = [Item(i) for i in range(40)]


@pytest.mark.parametrize("chunk", [1, 7])
def test_items_give_the_same_as_on_one_thread(executor, tmp_path, chunk):
    path = tmp_path / "s.jsonl"
    assert run_items(work, ITEMS, executor=executor, chunk=chunk, store=path) == [
        work(item) for item in ITEMS
    ]
    assert len(Store(path)) == 40


def test_an_error_of_the_function_comes_back(executor, tmp_path):
    (tmp_path / "poison").touch()
    with pytest.raises(ZeroDivisionError, match="item seven"):
        run_items(work, [Item(i, str(tmp_path)) for i in range(10)], executor=executor)
    (tmp_path / "poison").unlink()
    # Dask must not answer with the remembered failure.
    assert run_items(work, [Item(7, str(tmp_path))], executor=executor) == [work(Item(7))]


def test_a_result_that_cannot_be_sent_is_refused(executor):
    with pytest.raises(TypeError, match="results from another process must be picklable: cannot pickle"):
        run_items(open, [os.devnull], executor=executor)


def test_a_worker_killed_from_outside_is_made_up_for(client, executor, tmp_path):
    victims = [nanny.pid for nanny in client.cluster.workers.values()][:1]

    def kill(done, total):
        if done >= 3 and victims:
            os.kill(victims.pop(), signal.SIGKILL)

    path = tmp_path / "s.jsonl"
    assert run_items(slowly, ITEMS, executor=executor, store=path, progress=kill) == [
        work(item) for item in ITEMS
    ]
    assert not victims
    assert len(Store(path)) == 40


def test_a_study_that_kills_its_workers_ends_and_goes_on(executor, tmp_path):
    """Item 7 kills every worker that gets it, so that dask gives up."""
    (tmp_path / "poison").touch()
    items = [Item(i, str(tmp_path), "kill") for i in range(40)]
    path = tmp_path / "s.jsonl"
    with pytest.raises(StudyInterrupted) as caught:
        run_items(slowly, items, executor=executor, store=path)
    done = len(Store(path))
    assert caught.match(
        r"^the executor died after \d+ of 40 items \(KilledWorker: .*run again with the same store"
    )
    counted = int(re.findall(r"\d+", str(caught.value))[0])
    assert 6 <= counted <= done < 40, "what comes between the count and the end is kept too"
    assert_goes_on(slowly, tmp_path / "again", 40, done, executor=executor, store=path)


def test_ctrl_c_withdraws_all_in_one_message(client, executor, tmp_path, monkeypatch):
    """One by one takes 3 ms each: a minute for 20 000."""
    cancel, third = Mock(wraps=client.cancel), Mock(side_effect=[None, None, KeyboardInterrupt])
    monkeypatch.setattr(client, "cancel", cancel)
    items, store = [Item(i, str(tmp_path)) for i in range(400)], Store(tmp_path / "s.jsonl")
    with pytest.raises(KeyboardInterrupt):
        run_items(slowly, items, executor=executor, store=store, progress=third)
    assert cancel.call_count == 1
    assert len(store) >= 3
    assert run_items(work, [Item(1)], executor=executor) == [work(Item(1))], "after what had begun"
    assert len(calls(tmp_path)) < 400


def test_a_closed_client_ends_the_study(client, tmp_path):
    store = Store(tmp_path / "s.jsonl")
    with distributed.Client(client.cluster.scheduler_address, set_as_default=False) as other:
        executor = other.get_executor()
        refused(
            (
                lambda: run_items(
                    slowly, ITEMS, executor=executor, store=store, progress=lambda *_: other.close()
                ),
                r"died after \d+ of 40 items \(CancelledError\)",
                StudyInterrupted,
            ),
            (
                lambda: run_items(slowly, ITEMS, executor=executor, store=store),
                r"died after \d+ of 40 items \(ClosedClientError: ",
                StudyInterrupted,
            ),
        )
    assert len(store) >= 1
