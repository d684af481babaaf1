"""Replay: equal traces are found equal, and others give the first difference."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from command_line import refusal, said
from session_scenes import SEED, make_records, refused, small_bone, writer

import burrlab

TICKS = 5000


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """(file, digest at the end) of two burrs, made by contacts, independent of the replay."""
    file = tmp_path_factory.mktemp("replay") / "session.h5"
    bone = small_bone()
    begun = bone.digest()
    records = make_records(bone, TICKS, burrs=2, first=30)
    middle = small_bone()
    make_records(middle, 1234, burrs=2, first=30)
    made = writer(file, records, burrs=2)
    for tick, digest in ((30, begun), (1264, middle.digest()), (5030, bone.digest())):
        made.add_digest(tick, digest)
    made.stop()
    return file, bone.digest()


@pytest.fixture(scope="module")
def trace(session):
    return burrlab.load_trace(session[0])


def test_a_session_is_replayed_bit_for_bit_on_every_cpu_path(session, trace, cpu_path):
    done = []
    again = burrlab.replay(trace, progress=done.append)
    assert (again.equal, again.ticks, again.digests, again.tick, again.bone.digest(), again.cpu_path) == (
        True, TICKS, 3, 5030, session[1], cpu_path,
    )  # fmt: skip
    assert again.bone.removed > trace.bone().removed + 1.0
    assert (done[-1], done) == (1.0, sorted(done))


def test_until_a_tick(trace):
    half = burrlab.replay(trace, until=1264)
    assert (half.ticks, half.digests, half.tick, half.equal) == (1234, 2, 1264, True)
    assert half.bone.digest() == trace.digests[1][1]
    none = burrlab.replay(trace, until=30)
    assert (none.ticks, none.digests, none.equal) == (0, 1, True)


def test_what_is_refused(trace):
    nowhere = changed(trace, 100, 0, "center_mm", lambda _: np.nan, 0)
    refused(
        (lambda: burrlab.replay(trace, until=29), "until must be from 30 to 5030, got 29"),
        (lambda: burrlab.replay(trace, until=5031), "until must be from 30 to 5030, got 5031"),
        (lambda: burrlab.replay(nowhere), "center of a tick must be finite"),
    )


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
    ("tick", "burr", "name", "change", "axis"),
    [
        (30, 0, "force_N", flip, 2), (2030, 1, "force_N", np.negative, 1), (3333, 1, "penetration_mm", flip, None),
        (5029, 0, "removed_levels", lambda n: n + 1, None), (2029, 1, "touching", lambda t: 1 - t, None),
        (5029, 1, "ambiguous", lambda t: 1 - t, None),
    ],
)  # fmt: skip
def test_one_bit_is_found_with_tick_burr_and_field(trace, tick, burr, name, change, axis):
    again = burrlab.replay(changed(trace, tick, burr, name, change, axis))
    assert (again.equal, again.difference.tick, again.difference.burr, again.difference.field) == (
        False, tick, burr, name,
    )  # fmt: skip
    assert f"different: tick {tick}, burr {burr}: {name} is" in repr(again)


def test_the_first_of_two_differences_is_named(trace):
    trace = changed(trace, 2500, 0, "force_N", flip, 0)
    trace = changed(trace, 2499, 1, "removed_levels", lambda n: n + 1)
    difference = burrlab.replay(trace).difference
    assert (difference.tick, difference.burr, difference.field) == (2499, 1, "removed_levels")


def test_other_inputs_give_another_session(trace):
    ticks = trace.ticks.copy()
    ticks["k"][870] += 1
    for other in (
        changed(trace, 900, 0, "center_mm", lambda x: x + 1e-3, 2),
        changed(trace, 900, 0, "on", lambda on: 1 - on),
        replace(trace, ticks=ticks),
    ):
        assert burrlab.replay(other).difference.tick in (900, 901)
    assert not burrlab.replay(replace(trace, seed=SEED + 1)).equal
    assert burrlab.replay(changed(trace, 9, 0, "radius_mm", lambda R: 2 * R)).difference.field == "radius_mm"


def test_a_recorded_nan_differs_and_goes_into_json(trace):
    trace = changed(trace, 50, 0, "force_N", lambda _: np.nan, 0)
    found = burrlab.replay(trace).to_dict()["difference"]
    assert (found["tick"], found["field"]) == (50, "force_N")
    assert "nan" in json.loads(json.dumps(found, allow_nan=False))["recorded"]


def test_what_is_for_analysis_only_is_not_compared(trace):
    ticks = trace.ticks.copy()
    for name in ("sent_force_N", "device_position_mm", "device_velocity_mm_s", "age_ms"):
        ticks["burr"][name] = 1e3
    ticks["time_s"] = 0.0
    assert burrlab.replay(replace(trace, ticks=ticks)).equal


def test_another_digest_is_found(trace):
    wrong = "f" * 32
    again = burrlab.replay(replace(trace, digests=(trace.digests[0], (1264, wrong))))
    assert (again.ticks, again.digests) == (1234, 2)
    assert (again.difference.burr, again.difference.field) == (None, "digest")
    assert str(again.difference) == (
        f"after 1264 ticks the digest is {trace.digests[1][1]}, recorded {wrong}"
    )


def test_command_line(session, tmp_path, capsys):
    other, text = tmp_path / "other.h5", tmp_path / "text.h5"
    other.write_bytes(session[0].read_bytes())
    with h5py.File(other, "a") as file:
        file["ticks"][777, "burr1_removed_levels"] += 1
    text.write_text("text")
    told = said(capsys, "replay", other, status=1)
    assert told.startswith("different: tick 807, burr 1: removed_levels is ")
    told = said(capsys, "replay", other, "--until", 1264, "--json", "-", status=1)
    assert json.loads(told)["difference"]["tick"] == 807
    told = said(capsys, "replay", session[0], "--until", 1264)
    assert told == "equal: 1234 ticks from 30, 2 digests compared\nstopped\n"
    for arguments, sentence in (
        ([tmp_path / "none.h5"], f"burrlab replay: {tmp_path / 'none.h5'}: No such file or directory\n"),
        ([text], "is not a burrlab trace"), ([session[0], "--until", 1],
         "until must be from 30 to 5030, got 1"),
        ([session[0], "--until", "x"], "must be a whole number from 0, got 'x'"),
    ):  # fmt: skip
        assert sentence in refusal(capsys, "replay", *arguments)
