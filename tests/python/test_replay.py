"""Replay: equal where it is, and the first difference where it is not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import h5py
import numpy as np
import pytest
from session_scenes import SEED, FakeReader, make_records, small_bone, tools

import burrlab
import burrlab._core as _core
from burrlab.cli import main

TICKS = 5000


def write(file, records, *, burrs=1, digests=(), first=0):
    start = small_bone()
    made = burrlab.TraceWriter(file, FakeReader(records), start, tools(burrs), seed=SEED, first_tick=first)
    for tick, digest in digests:
        made.add_digest(tick, digest)
    made.stop()
    assert made.complete


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """(file, digest at the end) of two burrs, made by contacts: none of the code that replays it."""
    file = tmp_path_factory.mktemp("replay") / "session.h5"
    bone = small_bone()
    begun = bone.digest()
    records = make_records(bone, TICKS, burrs=2, first=30)
    middle = small_bone()
    make_records(middle, 1234, burrs=2, first=30)
    digests = [(30, begun), (1264, middle.digest()), (5030, bone.digest())]
    write(file, records, burrs=2, digests=digests, first=30)
    return file, bone.digest()


def test_a_session_is_replayed_bit_for_bit(session):
    trace = burrlab.load_trace(session[0])
    done = []
    again = burrlab.replay(trace, progress=done.append)
    assert again.equal
    assert (again.ticks, again.digests, again.tick) == (TICKS, 3, 5030)
    assert again.bone.digest() == session[1]
    assert again.bone.removed > trace.bone().removed + 1.0
    assert done[-1] == 1.0
    assert done == sorted(done)
    assert repr(again) == "Replay(equal, 5000 ticks, 3 digests)"


def test_equal_on_every_cpu_path(session, cpu_path):
    again = burrlab.replay(burrlab.load_trace(session[0]))
    assert again.equal
    assert again.cpu_path == cpu_path
    assert again.bone.digest() == session[1]


def test_equal_in_several_threads_at_once(session):
    trace = burrlab.load_trace(session[0])
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: burrlab.replay(trace), range(8)))
    assert all(one.equal and one.bone.digest() == session[1] for one in found)


@pytest.mark.parametrize("path", _core.cpu_paths())
def test_equal_in_a_process_on_another_path(session, path):
    run = subprocess.run(
        [sys.executable, "-m", "burrlab", "replay", str(session[0]), "--json", "-"], capture_output=True, text=True,
        env={**os.environ, "BURRLAB_CPU_PATH": path, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    result = json.loads(run.stdout)
    assert run.returncode == 0
    assert (result["equal"], result["cpu_path"], result["digest"]) == (True, path, session[1])


def test_until_a_tick(session):
    trace = burrlab.load_trace(session[0])
    half = burrlab.replay(trace, until=1264)
    assert (half.ticks, half.digests, half.tick, half.equal) == (1234, 2, 1264, True)
    assert half.bone.digest() == trace.digests[1][1]
    none = burrlab.replay(trace, until=30)
    assert (none.ticks, none.digests, none.equal) == (0, 1, True)
    for until in (29, 5031):
        with pytest.raises(ValueError, match=f"until must be from 30 to 5030, got {until}"):
            burrlab.replay(trace, until=until)


def flip(value):
    """The neighbouring float."""
    return np.nextafter(value, 1e9)


def changed(trace, tick, burr, name, change, axis=None):
    ticks = trace.ticks.copy()
    column = ticks["burr"][name]
    at = (tick - trace.first_tick, burr) + (() if axis is None else (axis,))
    column[at] = change(column[at])
    return replace(trace, ticks=ticks)


@pytest.mark.parametrize(
    ("name", "change", "axis"),
    [
        ("force_N", flip, 2), ("force_N", np.negative, 1), ("penetration_mm", flip, None),
        ("removed_levels", lambda n: n + 1, None), ("touching", lambda t: 1 - t, None),
        ("ambiguous", lambda t: 1 - t, None),
    ],
)  # fmt: skip
@pytest.mark.parametrize(("tick", "burr"), [(30, 0), (2030, 1), (3333, 1), (5029, 0)])
def test_one_bit_is_found_with_tick_burr_and_field(session, name, change, axis, tick, burr):
    trace = changed(burrlab.load_trace(session[0]), tick, burr, name, change, axis)
    again = burrlab.replay(trace)
    assert not again.equal
    assert (again.difference.tick, again.difference.burr, again.difference.field) == (tick, burr, name)
    assert f"different: tick {tick}, burr {burr}: {name} is" in repr(again)


def test_the_first_of_two_differences_is_named(session):
    trace = burrlab.load_trace(session[0])
    trace = changed(trace, 2500, 0, "force_N", flip, 0)
    trace = changed(trace, 2499, 1, "removed_levels", lambda n: n + 1)
    difference = burrlab.replay(trace).difference
    assert (difference.tick, difference.burr, difference.field) == (2499, 1, "removed_levels")


@pytest.mark.parametrize("name", ["center_mm", "on"])
def test_other_inputs_give_another_session(session, name):
    trace = burrlab.load_trace(session[0])
    change = (lambda x: x + 1e-3) if name == "center_mm" else (lambda on: 1 - on)
    again = burrlab.replay(changed(trace, 900, 0, name, change, 2 if name == "center_mm" else None))
    assert not again.equal
    assert again.difference.tick in (900, 901)


def test_another_k_seed_or_first_tick_gives_another_session(session):
    trace = burrlab.load_trace(session[0])
    ticks = trace.ticks.copy()
    ticks["k"][500] += 1
    assert burrlab.replay(replace(trace, ticks=ticks)).difference.tick in (530, 531)
    assert not burrlab.replay(replace(trace, seed=SEED + 1)).equal


def test_a_recorded_nan_differs_and_goes_into_json(session):
    trace = changed(burrlab.load_trace(session[0]), 50, 0, "force_N", lambda _: np.nan, 0)
    found = burrlab.replay(trace).to_dict()["difference"]
    assert (found["tick"], found["field"]) == (50, "force_N")
    assert "nan" in json.loads(json.dumps(found, allow_nan=False))["recorded"]


def test_what_is_for_analysis_only_is_not_compared(session):
    trace = burrlab.load_trace(session[0])
    ticks = trace.ticks.copy()
    for name in ("sent_force_N", "device_position_mm", "device_velocity_mm_s", "age_ms", "radius_mm"):
        ticks["burr"][name] = 1e3
    ticks["time_s"] = 0.0
    assert burrlab.replay(replace(trace, ticks=ticks)).equal


def test_another_digest_is_found(session):
    trace = burrlab.load_trace(session[0])
    wrong = "f" * 32
    again = burrlab.replay(replace(trace, digests=(trace.digests[0], (1264, wrong))))
    assert (again.ticks, again.digests) == (1234, 2)
    assert (again.difference.burr, again.difference.field) == (None, "digest")
    assert str(again.difference) == (
        f"after 1264 ticks the digest is {trace.digests[1][1]}, recorded {wrong}"
    )


def test_a_centre_that_no_session_has(session):
    trace = changed(burrlab.load_trace(session[0]), 100, 0, "center_mm", lambda _: np.nan, 0)
    with pytest.raises(ValueError, match="center of a tick must be finite"):
        burrlab.replay(trace)


def call(capsys, *arguments):
    try:
        code = main([str(a) for a in arguments])
    except SystemExit as stop:
        code = stop.code
    return code, *capsys.readouterr()


def test_command_line(session, tmp_path, capsys):
    code, out, _ = call(capsys, "replay", session[0])
    assert code == 0
    assert out == "equal: 5000 ticks from 30, 3 digests compared\nstopped\n"
    code, out, _ = call(capsys, "replay", session[0], "--until", 1264, "--json", "-")
    result = json.loads(out)
    assert (code, result["ticks"], result["digests"], result["difference"]) == (0, 1234, 2, None)
    assert result["recorded_with"]["burrlab"] == burrlab.__version__

    other = tmp_path / "other.h5"
    other.write_bytes(session[0].read_bytes())
    with h5py.File(other, "a") as file:
        row = file["ticks"][777]
        row["burr"]["removed_levels"][1] += 1
        file["ticks"][777] = row
    code, out, _ = call(capsys, "replay", other)
    assert code == 1
    assert out.startswith("different: tick 807, burr 1: removed_levels is ")
    code, out, _ = call(capsys, "replay", other, "--json", "-")
    assert (code, json.loads(out)["difference"]["tick"]) == (1, 807)

    code, _, err = call(capsys, "replay", tmp_path / "none.h5")
    assert code == 2
    assert err == f"burrlab replay: {tmp_path / 'none.h5'}: No such file or directory\n"
    (tmp_path / "text.h5").write_text("text")
    code, _, err = call(capsys, "replay", tmp_path / "text.h5")
    assert code == 2
    assert "is not a burrlab trace" in err
    code, _, err = call(capsys, "replay", session[0], "--until", 1)
    assert code == 2
    assert "until must be from 30 to 5030, got 1" in err
    code, _, err = call(capsys, "replay", session[0], "--until", "x")
    assert code == 2
    assert "must be a whole number from 0, got 'x'" in err
