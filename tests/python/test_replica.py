"""A replica holds the leader's bone to the bit, whatever the network does.

The tests take two seconds each; those marked slow take half a minute.
"""

import random
from functools import partial

import pytest
from replica_scenes import (
    Leader,
    Proxy,
    ReplicaProcess,
    Slower,
    TickEditor,
    cutter,
    dropper,
    mangler,
    soon,
)

import burrlab._core as _core
from burrlab.session.anatomy import status_text
from burrlab.session.network import follow, make_bone


def lengths(short):
    """Lengths [ticks]: always `short`, and half a minute if slow tests run."""
    return pytest.mark.parametrize("ticks", [short, pytest.param(30_000, marks=pytest.mark.slow)])


def finish(leader, ticks, *replicas, within=5):
    """Ends the session at a tick; every replica hears of it."""
    leader.run_to(ticks)
    leader.end()
    for replica in replicas:
        assert replica.wait(within), replica.status


def check_equal(leader, status, digest):
    """Asserts that the replica knows of the leader's end and holds the same bone."""
    due = {"ended": True, "failed": False, "reason": "done", "tick": leader.tick, "digests_different": 0,
           "differing_ticks": 0, "divergences": []}  # fmt: skip
    assert {name: status[name] for name in due} == due
    assert digest == leader.digest == leader.executor.bone.digest()
    assert leader.follower.status["rebuilds"] == 0


@lengths(1500)
@pytest.mark.parametrize(("burrs", "version", "path"), [(1, 2, None), (2, 1, "scalar")])
def test_replica_in_another_process(burrs, version, path, ticks):
    """The replica may use another CPU path than the leader."""
    with Leader(burrs=burrs, header_version=version) as leader:
        replica = ReplicaProcess(leader.port, cpu_path=path)
        finish(leader, leader.tick + ticks)  # its start may have taken longer than the log
    result = replica.result()
    check_equal(leader, result, result["digest"])
    assert result["waited"]
    assert result["digests_equal"] >= 5
    assert leader.executor.bone.removed > 0


@lengths(2000)
def test_killed_and_restarted_replica_catches_up(ticks):
    with Leader() as leader:
        for share in (0.2, 0.4, 0.6):
            replica = ReplicaProcess(leader.port)
            leader.run_to(int(share * ticks))
            replica.kill()
        replica = ReplicaProcess(leader.port)
        finish(leader, ticks)
    result = replica.result()
    check_equal(leader, result, result["digest"])
    # Missing ticks are in the log of 10 s; otherwise bricks come.
    if 0.6 * ticks > 10_000:
        assert result["by_bricks"] == 1


@pytest.mark.parametrize(
    ("pump", "least"),
    [(partial(dropper, probability=0.01, random=random.Random(1)), 1), (cutter, 2), (mangler, 2)],
)
@lengths(3000)
def test_proxy_that_breaks_the_stream(pump, least, ticks):
    """The proxy drops messages, cuts the stream, or drops bytes."""
    with Leader() as leader, Proxy(leader.port, pump) as proxy:
        replica = follow("127.0.0.1", proxy.port)
        finish(leader, ticks, replica, within=20)
    check_equal(leader, replica.status, replica.digest())
    assert replica.status["faults"] >= least
    assert replica.status["most_missed"] <= 100


def switch_off(tick):
    """Changes the last burr's tick just before a digest: its results are then those of a burr that is off."""
    burr = tick[-16:]
    on, removed = 5, 10  # places in a burr's numbers (docs/wire.md)
    if tick[0] < 500 or tick[0] % 100 != 99 or burr[removed] == 0:
        return False
    burr[[on, removed]] = 0
    return True


@pytest.mark.parametrize("burrs", [1, 2])
def test_corrupted_brick_is_named_and_repaired(burrs):
    """A proxy changes a tick so that its results are right, but not the bone."""
    with Leader(burrs=burrs) as leader, Proxy(leader.port, TickEditor(switch_off)) as proxy:
        replica = follow("127.0.0.1", proxy.port)
        leader.run_to(500)
        assert soon(lambda: replica.status["divergences"])
        finish(leader, 1500, replica)
    status = replica.status
    (found,) = status["divergences"]
    assert (found["what"], found["exact"], found["tick"] % 100) == ("digest", True, 0)
    assert 0 < len(found["bricks"]) < 30
    assert (status["digests_different"], status["differing_ticks"], status["by_bricks"]) == (1, 0, 1)
    assert (status["tick"], replica.digest()) == (leader.tick, leader.digest)
    told = status_text({**status, "digest": leader.digest}).splitlines()
    assert told[0] == f"ended (done): tick {leader.tick}, digest {leader.digest}"
    assert told[1].endswith("equal, 1 different; ticks with another result: 0")
    count = f"{len(found['bricks'])} bricks replaced"
    assert told[-1] == f"  bone not the leader's at tick {found['tick']}: digest, {count}"


def lift(tick):
    if tick[0] < 1000:
        return False
    tick[7] += 0.01  # z of burr 0 [mm]
    return True


def test_corruption_under_the_burr_is_found_by_its_force():
    with (
        Leader(digest_every=1_000_000) as leader,
        Proxy(leader.port, TickEditor(lift)) as proxy,
    ):
        replica = follow("127.0.0.1", proxy.port)
        assert soon(lambda: replica.status["divergences"])
        finish(leader, 0, replica)
    status = replica.status
    assert status["divergences"][0]["what"].endswith("of burr 0")
    assert status["differing_ticks"] >= 1
    assert replica.digest() == leader.digest


def test_out_of_the_log_it_is_given_bricks():
    with Leader(log=0.2) as leader:
        leader.run_to(1500)
        replica = follow("127.0.0.1", leader.port)
        finish(leader, 2000, replica)
    check_equal(leader, replica.status, replica.digest())
    assert replica.status["by_bricks"] >= 1


def test_bricks_are_there_after_the_end():
    with Leader(log=0.1) as leader:
        waiting = follow("127.0.0.1", leader.port)
        late = _core.Replica("127.0.0.1", leader.port)
        assert late.fetch_hello()
        leader.run_to(1000)
        with Proxy(leader.port, Slower(40_000)) as proxy:
            slow = follow("127.0.0.1", proxy.port)  # keeps the leader's end from finishing at once
            leader.loop.stop()
            leader.follower.stop()
            late.start(make_bone(leader.hello["source"]), leader.tools, 7)
            leader.publisher.finish("done", linger=20.0)
            assert waiting.wait(5)
            assert late.wait(5)
            assert slow.wait(20)
    for replica in (waiting, late, slow):
        check_equal(leader, replica.status, replica.digest())


@lengths(3000)
def test_slow_replica_is_cut_off_and_comes_back(ticks):
    """The stream needs 190 kB a second; the proxy passes less and buffers little."""
    with (
        Leader(most_behind=30_000, log=0.5) as leader,
        Proxy(leader.port, Slower(60_000), receive_buffer=4096) as proxy,
    ):
        slow, quick = follow("127.0.0.1", proxy.port), follow("127.0.0.1", leader.port)
        leader.run_to(ticks)
        proxy.pump.rate = 1e9
        # Leaders that end await a lost replica for 3 s. A busy machine may tell it of its cut later.
        assert soon(lambda: slow.status["tick"] >= ticks), slow.status
        finish(leader, ticks, slow, quick, within=20)
    assert leader.publisher.status["cut_off"] >= 1
    for replica in (quick, slow):
        check_equal(leader, replica.status, replica.digest())
    assert slow.status["faults"] >= 1
    assert slow.status["by_bricks"] + slow.status["by_ticks"] >= 1


def test_rebuilt_follower_sends_bricks():
    """Ticks that the follower passed over cannot be sent, so its replicas take the bone."""
    with Leader() as leader:
        replica = follow("127.0.0.1", leader.port)
        leader.run_to(500)
        leader.follower.ask_rebuild()
        assert soon(lambda: leader.follower.status["rebuilds"] == 1)
        finish(leader, 1500, replica)
    assert replica.digest() == leader.digest == leader.executor.bone.digest()
    assert leader.follower.status["differing"] == 0


def test_a_leader_that_has_gone_and_another_session_on_its_port():
    with Leader() as leader:
        replica, stopped = (follow("127.0.0.1", leader.port) for _ in range(2))
        leader.run_to(300)
        port = leader.port
    assert soon(lambda: stopped.status["faults"] >= 1 and not stopped.status["connected"])
    assert not stopped.status["ended"]
    stopped.stop()
    assert stopped.status["reason"] == "stopped"
    with Leader(port=port):
        assert replica.wait(5)
    assert (replica.status["failed"], replica.status["reason"]) == (
        True,
        "the leader has begun another session",
    )
