"""Secondary effects beside a running session: its end, rebuilds, stops, and their cost."""

import importlib
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from effects_scenes import bone_with_tissues, levels_removed, session
from session_scenes import refused

from burrlab import _core, load_trace
from burrlab.effects import Camera, Companion, EffectParameters, Effects, Nozzle, Sucker, effects_of
from burrlab.session.network import follow
from burrlab.session.player import TracePlayer

WATER = Nozzle((2, 0, 3), (-0.5, 0, -0.9), rate=100)
CAMERA = Camera((0, -40, 60), (0, 0, 0))


def exact(companion: Companion) -> bool:
    return all(account.exact for account in companion.balance().values())


def ended(companion: Companion) -> bool:
    """Whether it ended by itself, without an error."""
    return companion.wait(60) and not companion.running and companion.error == ""


def test_on_a_replica_beside_another_consumer() -> None:
    """Removed bone becomes dust of its own tissue, though another consumer takes the changes too."""
    made = session(1.5, wall_clock=True, realtime=False, publish=0)
    replica = follow("127.0.0.1", made.port, bone=bone_with_tissues())
    with Companion(replica, seed=1, nozzle=WATER, rate=50) as companion, made:
        seen = []
        while not replica.wait(0.05):
            seen.append(replica.take()["bricks"])
        assert ended(companion)
        bone, ticks = replica.snapshot()
        newest = companion.newest()
    replica.stop()
    assert bone.digest() == made.snapshot()[0].digest()
    assert newest["tick"] == ticks > 100
    assert newest["balance"]["dust"].made == levels_removed(bone) == sum(newest["removed"]) > 0
    assert newest["removed"] == [
        round(bone.removed_of(i) / companion.quantum) for i in range(len(newest["removed"]))
    ]
    assert newest["balance"]["blood"].made > 0 < newest["balance"]["water"].made
    assert exact(companion)
    assert {tuple(brick) for bricks in [*seen, replica.take()["bricks"]] for brick in bricks} == {
        tuple(place)
        for place in np.unique(np.argwhere(bone.density != bone_with_tissues().density) // 8, axis=0)
    }


@pytest.mark.parametrize("tick", [0, 70_000])
def test_its_frames_come_again_from_the_trace(tmp_path: Path, tick: int) -> None:
    """With a budget that no machine meets, a start in the middle, and a bone with earlier ticks."""
    sucker = Sucker((0, 2, 1))
    water = Nozzle(WATER.position, WATER.direction, rate=1000)  # So much that some always hides the burr.
    with session(1.0, wall_clock=True, realtime=False, tick=tick, record=tmp_path / "trace.h5") as made:
        made.wait(0.2)
        with Companion(
            made, seed=5, rate=100, budget=1e-5, nozzle=water, sucker=sucker, camera=CAMERA
        ) as companion:
            assert companion.wait(60)
    assert companion.report().over_budget > 0
    player = TracePlayer(load_trace(tmp_path / "trace.h5"))
    assert companion.first_tick > tick
    player.seek_tick(companion.first_tick)
    again = Effects(player.bone, seed=5, nozzle=water, sucker=sucker, camera=CAMERA)
    list(effects_of(player, again, frames=companion.frames))
    assert 0 < again.hidden == companion.hidden < 1
    assert len(again.parcels) > 0
    assert (again.parcels == companion.parcels).all()
    assert again.balance() == companion.balance()
    first, last = tick + 3, tick + player.ticks + 1
    refused(
        (lambda: effects_of(player, again, frames=[(0.05, first, (99, 1, 1)), (0.05, last, (99, 1, 1))]),
         f"frames must be from {tick} to {last - 1}, got {first} to {last}"),
    )  # fmt: skip


def test_stopped_in_the_middle_and_changed_while_it_runs() -> None:
    with session(2.0, wall_clock=True, realtime=False) as made:
        companion = Companion(made, seed=1, rate=100, camera=CAMERA)
        assert math.isnan(companion.hidden)
        companion.start()
        assert not companion.wait(0.3)
        companion.set_nozzle(WATER)
        companion.set_sucker(Sucker((0, 2, 1)))
        time.sleep(0.3)
        assert companion.running
        assert 0 <= companion.hidden <= 1
        companion.set_camera(None)
        companion.stop()
        companion.stop()
        assert (companion.running, made.running) == (False, True)
        frames = companion.report().frames
        time.sleep(0.1)
        assert companion.report().frames == frames
        assert companion.balance()["water"].made > 0
        assert exact(companion)
        refused((companion.start, "companion must be started once"))


def test_it_outlives_the_names_of_session_and_companion() -> None:
    made = session(30.0, wall_clock=True, realtime=False).start()
    companion = Companion(made, seed=1, rate=200).start()
    made.stop()
    del made
    assert companion.wait(60)
    Companion(session(0.1), seed=1).start()  # ends with its last reference


@pytest.mark.parametrize("recorded", [False, True])
@pytest.mark.parametrize("stopped", [False, True])
def test_it_ends_with_a_session_that_was_never_started(tmp_path: Path, recorded: bool, stopped: bool) -> None:
    """The companion ends at once if the session is stopped or gone, without the garbage collector."""
    made = session(1.0, **({"record": tmp_path / "trace.h5"} if recorded else {}))
    companion = Companion(made, seed=1, rate=100).start()
    assert not companion.wait(0.1)
    if stopped:
        made.stop()
        assert Companion(made, seed=1, rate=100).start().wait(20)
    del made
    assert ended(companion)
    assert companion.balance()["dust"].made == 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_fork_does_not_wait_for_its_thread() -> None:
    """The fork stops the companion, deletes it or does nothing."""
    program = (
        "import os, sys\n"
        "from effects_scenes import session\n"
        "from burrlab.effects import Companion\n"
        "made = session(60.0, wall_clock=True, realtime=False)\n"
        "companion = Companion(made, seed=1, rate=50).start()\n"
        "assert not companion.wait(0.2)\n"
        "for end in ('companion.stop()', 'del companion', 'pass'):\n"
        "    child = os.fork()\n"
        "    if child == 0:\n"
        "        exec(end)\n"
        "        sys.exit(7)\n"
        "    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), companion.running, flush=True)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], cwd=Path(__file__).parent, stdout=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as parent:  # fmt: skip
        try:
            said, _ = parent.communicate(timeout=30)
        except subprocess.TimeoutExpired:
            os.killpg(parent.pid, signal.SIGKILL)
            raise
    assert said == 3 * "7 True\n"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"session": _core.Replica("127.0.0.1", 1)}, "replica must be started first"),
        ({"rate": 0}, "rate must be from 1 to 200 Hz, got 0"),
        ({"rate": float("nan")}, "rate must be from 1 to 200 Hz, got nan"),
        ({"budget": -1}, "budget must be positive"),
        ({"seed": 1.5}, "seed must be a whole number"),
        ({"spin": (0, 0, 0)}, "length of spin must be positive"),
    ],
)
def test_refusals(options: dict, sentence: str) -> None:
    refused((lambda: Companion(**{"session": session(0.1), **options}), sentence))


@pytest.mark.slow
def test_twenty_thousand_parcels_beside_the_loop(capsys, monkeypatch) -> None:
    """In 60 s the balance is exact on any machine. The times are printed, not tested."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "bench")
    text = importlib.import_module("effects").run(60.0, 20_000, alone_first=True)
    with capsys.disabled():
        print("\n" + text)
    assert text.endswith("dust made = bone removed: True")
    assert int(text.split("with up to ")[1].split()[0]) > EffectParameters().most_parcels // 2
