"""The player: any moment of a trace to the bit, reached in any way."""

import threading

import numpy as np
import pytest
from session_scenes import make_records, recorded, refused, small_bone

from burrlab import VoxelBone, _core
from burrlab.session.player import BrickHistory, TracePlayer

TICKS, FIRST = 3000, 30
MOMENTS = (0, 1, 249, 250, 251, 777, 1500, 2999, 3000)  # executed ticks


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """(trace, digest at each moment), made by contacts, independent of the player."""
    digests = {}
    for moment in MOMENTS:
        bone = small_bone()
        records = make_records(bone, moment, burrs=2, first=FIRST) if moment else None
        digests[moment] = bone.digest()
    return recorded(tmp_path_factory.mktemp("player") / "session.h5", records, burrs=2), digests


@pytest.mark.parametrize("prepared", [False, True])
@pytest.mark.parametrize("memory", [256.0, 0.1])
def test_every_moment_is_that_of_the_session(scene, prepared, memory):
    player = TracePlayer(scene[0], every=0.1, memory=memory)
    if prepared:
        assert player.prepare()
        assert player.done == 0
    for moment in [*MOMENTS, *reversed(MOMENTS), *np.random.default_rng(1).choice(MOMENTS, 30)]:
        player.seek_tick(FIRST + int(moment))
        assert (player.done, player.tick, player.bone.digest()) == (moment, FIRST + moment, scene[1][moment])
    states, size = player.kept
    assert size <= memory * 1e6
    assert (states > 20) == (memory > 100)


def test_changed_bricks_are_those_that_differ(scene):
    player = TracePlayer(scene[0], every=0.1)
    view, counts = player.bone.density, [-(-n // 8) for n in player.bone.shape]
    for moment in np.random.default_rng(2).integers(0, TICKS + 1, 40):
        bricks = player.seek_tick(FIRST + int(moment))
        assert (np.diff(bricks.astype(int)) > 0).all()
        now = player.bone.density
        differ = np.ravel_multi_index(tuple((np.argwhere(now != view) // 8).T), counts)
        assert np.isin(differ, bricks).all()
        view = now
    assert len(player.seek_tick(player.tick)) == 0


def test_seconds_count_whole_ticks(scene):
    player, times = TracePlayer(scene[0]), scene[0].time()
    assert (player.time, player.done, player.duration) == (0.0, 0, pytest.approx(times[-1]))
    for done in (1, 2, 1234, TICKS):
        for late in (0.0, 0.0009):  # a tick that has not ended is not executed
            player.seek(min(times[done - 1] + late, player.duration))
            assert (player.done, player.time) == (done, times[done - 1])
    player.seek(0.0)
    assert (player.time, player.done) == (0.0, 0)


def test_burrs_force_and_depth_are_the_recorded_ones(scene):
    player, rows = TracePlayer(scene[0]), scene[0].ticks["burr"]
    assert not player.burrs.on.any()
    assert not player.force.any()
    assert (player.burrs.centers == rows["center_mm"][0]).all()
    player.seek_tick(FIRST + 2000)
    assert (player.burrs.centers == rows["center_mm"][1999]).all()
    assert (player.burrs.radii == [burr.radius for burr, _ in scene[0].tools]).all()
    assert (player.force == rows["force_N"][1999]).all()
    assert (player.depth == rows["penetration_mm"][1999]).all()
    history = player.history
    assert history.time[1999] == player.time
    assert history.force[1999] == pytest.approx(np.linalg.norm(player.force, axis=1))
    assert (history.depth[1999] == player.depth).all()


def test_prepares_beside_seeks(scene):
    player = TracePlayer(scene[0], every=0.02, memory=0.1)  # states are dropped meanwhile
    done = []
    thread = threading.Thread(target=player.prepare, args=(done.append,))
    thread.start()
    rng = np.random.default_rng(3)
    while thread.is_alive():
        moment = int(rng.choice(MOMENTS))
        player.seek_tick(FIRST + moment)
        assert player.bone.digest() == scene[1][moment]
    thread.join()
    assert (done[-1], player.prepared) == (1.0, 1.0)


def test_a_seek_beside_preparing_keeps_no_brick_twice(scene):
    alone, player, half = (
        TracePlayer(scene[0], every=0.1),
        TracePlayer(scene[0], every=0.1),
        threading.Event(),
    )
    assert alone.prepare()
    player.seek(
        player.duration,
        progress=lambda _: player.prepare(lambda part: half.set() if part > 0.5 else None, cancel=half),
    )
    assert player.kept == alone.kept


@pytest.mark.parametrize("states", [1.5, 2.5, 3.5, 4.5, 100])
def test_given_up_states_take_no_change_with_them(states):
    """Every tick changes two other bricks, so that a change lost with a state is found."""
    bone = VoxelBone.block((12.8, 1.6, 1.6), 0.2)
    history = BrickHistory(bone.copy(), int(states * 2 * 512))
    everything = np.arange(8, dtype=np.uint32)
    known = {0: _core.read_bricks(bone, everything)}
    rng = np.random.default_rng(1)
    for tick in range(1, 40):
        bricks = np.sort(rng.choice(8, 2, replace=False)).astype(np.uint32)
        _core.restore_bricks(bone, bricks, np.full((2, 512), 255 - tick, np.uint8))
        history.add(tick, bricks, bone)
        assert history.last == tick  # the next changes refer to it
        known[tick] = _core.read_bricks(bone, everything)
        kept = sorted({history.at_or_before(at) for at in range(tick + 1)})
        assert len(kept) == len(history)
        for at in kept:
            assert (history.levels(everything, at) == known[at]).all()
            differ = np.flatnonzero((known[at] != known[tick]).any(axis=1))
            assert np.isin(differ, history.changed_between(at, tick)).all()


def test_preparing_ends_when_asked(scene):
    player, cancel = TracePlayer(scene[0], every=0.1), threading.Event()
    assert not player.prepare(lambda part: cancel.set() if part > 0.2 else None, cancel=cancel)
    assert 0.1 < player.prepared < 0.5
    player.seek_tick(FIRST + 1500)
    assert player.bone.digest() == scene[1][1500]


def test_refusals(scene):
    player, seconds = TracePlayer(scene[0]), r"seconds must be from 0 to 3\.06"
    tick = f"tick must be from {FIRST} to {FIRST + 3000}, got "
    refused(
        (lambda: TracePlayer(scene[0], every=0), "every must be positive, got 0"),
        (lambda: TracePlayer(scene[0], memory=0), "memory must be positive, got 0"),
        *((lambda at=at: player.seek(at), seconds) for at in (-0.1, 3.1, float("nan"))),
        *((lambda at=at: player.seek_tick(at), f"{tick}{at}") for at in (FIRST - 1, FIRST + 3001)),
        (lambda: TracePlayer("session.h5"), "trace must be a Trace", TypeError),
    )


def test_bricks_are_restored_under_their_pristine_levels():
    bone = small_bone()
    bricks = np.array([0, 3], np.uint32)
    levels = _core.read_bricks(bone, bricks)
    assert levels.shape == (2, 512)
    before = bone.digest()
    _core.restore_bricks(bone, bricks, levels // 2)
    assert list(_core.take_changed_bricks(bone))[-1] >= 3
    assert bone.digest() != before
    assert (bone.pristine == small_bone().pristine).all()
    thin = VoxelBone.block((2, 2, 2), 0.2, level=100)
    dense = np.full((2, 512), 101, np.uint8)
    refused(
        (lambda: _core.restore_bricks(thin, bricks, dense), "must be at most its pristine level, got 101"),
        (lambda: _core.restore_bricks(bone, bricks, levels[:1]), r"density must have shape \(n, 512\)"),
        (lambda: _core.read_bricks(bone, [10**6]), "brick must be below"),
    )
    assert thin.removed == 0
    _core.restore_bricks(bone, bricks, levels)
    assert bone.digest() == before
