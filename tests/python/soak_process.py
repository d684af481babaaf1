"""Everything at once, in separate processes.

Usage: python soak_process.py lead SCENE FOLDER SECONDS [draw] | follow SCENE PORT. SCENE is a file of
`keep_scene`. `lead` runs a session on the phantom: watched, recorded, published, with effects and, if asked,
a drawn view. It prints its port, begins on a line of standard input, prints its use of the machine while it
runs, and its results at the end. `follow` is its replica.
"""

import ctypes
import json
import os
import pickle
import sys
import time
from pathlib import Path

import burrlab
from burrlab.anatomy import Watch, mastoidectomy_path, temporal_bone
from burrlab.cli.options import ended_by_signals
from burrlab.effects import Companion, EffectParameters, Nozzle, Sucker
from burrlab.session.anatomy import replica_events
from burrlab.session.network import follow

BURR = burrlab.Burr(3.0)
LOOK = 0.5  # between two prints of the use [s]


def keep_scene(file):
    """Writes a phantom and a path through it."""
    head = temporal_bone(0.4, seed=3)
    path = mastoidectomy_path(head, BURR, layer=0.75, speed=40.0)
    file.write_bytes(
        pickle.dumps((head.bone, tuple(map(float, head.entry)), (path.time, path.center, path.on)))
    )


def read_scene(file):
    """(bone, entry, path)"""
    return pickle.loads(file.read_bytes())


def effects_like(at):
    """Water onto the beginning of the cut, a sucker beside it, and a low limit of parcels, soon reached."""
    x, y, z = at
    return {
        "seed": 5, "parameters": EffectParameters(most_parcels=2000), "sucker": Sucker((x, y + 4.0, z)),
        "nozzle": Nozzle((x, y, z + 10.0), (0.0, 0.0, -1.0), rate=100),
    }  # fmt: skip


def say(**values):
    print(json.dumps(values), flush=True)


def usage():
    """Resident memory [MB] without freed memory in the allocator, open files and threads of this process."""
    ctypes.CDLL(None).malloc_trim(0)
    return {
        "rss": int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6,
        "files": len(os.listdir("/proc/self/fd")),
        "threads": len(os.listdir("/proc/self/task")),
    }


def as_text(events):
    return [repr(event) for event in events]


def lead(scene, folder, seconds, draw):
    bone, entry, path = read_scene(scene)
    session = burrlab.Session(
        bone, (BURR, bone.tissues.material), burrlab.ScriptedDevice(*path), seed=1, duration=seconds,
        record=folder / "trace.h5", publish=0, watch=Watch(bone, approach=3.0),
    )  # fmt: skip
    companion = Companion(session, budget=0.02, **effects_like(entry))
    view = None
    if draw:
        from burrlab.view.film import LiveView

        view = LiveView(session, effects=companion, off_screen=True, size=(320, 240), slices=True)
    taken = session.follower.view()
    say(port=session.port)
    sys.stdin.readline()
    ended, begin = "", time.monotonic()
    with ended_by_signals():
        try:
            with companion, session:
                while not session.wait(LOOK):
                    session.follower.take(taken)
                    if view is not None:
                        view.step()
                        view.scene.picture()
                    say(seconds=time.monotonic() - begin, ticks=session.ticks, **usage())
                companion.wait(30)
        except KeyboardInterrupt:
            ended = "signal"
    if view is not None:
        view.step()
    bone, ticks = session.snapshot()
    frames = {
        "frames": companion.frames,
        "parcels": companion.parcels.tobytes(),
        "first": companion.first_tick,
    }
    (folder / "frames").write_bytes(pickle.dumps(frames))
    say(
        ended=ended or "whole", reason=session.reason, ticks=ticks, digest=bone.digest(),
        events=as_text(session.anatomy().events), error=companion.error,
        exact=all(account.exact for account in companion.balance().values()),
        dust=companion.balance()["dust"].made, removed=sum(companion.newest()["removed"]),
        seen=companion.newest()["tick"], follower=session.follower.status,
        drawn=None if view is None else view.bone.digest(), messages=session.messages[-20:],
    )  # fmt: skip
    if view is not None:
        view.close()
    companion.stop()


def replicate(scene, port):
    replica = follow("127.0.0.1", port, bone=read_scene(scene)[0])
    say(following=True)
    while not replica.wait(LOOK):
        say(**{key: replica.status[key] for key in ("tick", "connected")}, **usage())
    replica.stop()
    say(digest=replica.digest(), events=as_text(replica_events(replica)), **replica.status)


if __name__ == "__main__":
    if sys.argv[1] == "lead":
        lead(Path(sys.argv[2]), Path(sys.argv[3]), float(sys.argv[4]), "draw" in sys.argv[5:])
    else:
        replicate(Path(sys.argv[2]), int(sys.argv[3]))
