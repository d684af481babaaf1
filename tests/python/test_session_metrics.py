"""Metrics of sessions whose motions and forces are known."""

import numpy as np
import pytest
from session_scenes import FakeReader, make_records, new_writer, recorded, small_bone, tools

from burrlab import VoxelBone, _core, load_trace, replay, session_metrics


def trace_of(tmp_path, center, *, period=1.0, **columns):
    """A trace with these centres and columns of the first burr, by their record names."""
    records = np.zeros(len(center), _core.record_dtype)
    records["index"], records["k"], records["burrs"] = np.arange(len(center)), 1, 1
    burr = records["burr"][:, 0]
    burr["center"], burr["touching"] = center, 1
    for name, values in columns.items():
        (records if name in ("k",) else burr)[name] = values
    file = tmp_path / "session.h5"
    new_writer(
        file, FakeReader(records), VoxelBone.block((2, 2, 2), 0.1), tools(), seed=1, period=period, duration=600
    ).stop()  # fmt: skip
    return load_trace(file)


def stroking(seconds, rate, amplitude, period=1.0):
    """Sinusoidal strokes along a slanted axis."""
    time = np.arange(1, round(seconds * 1000 / period) + 1) * period / 1000
    return amplitude * np.sin(2 * np.pi * rate * time)[:, None] * np.array([[0.6, 0.0, 0.8]])


@pytest.mark.parametrize("period", [0.5, 1.0, 2.0])
def test_sinusoidal_strokes(tmp_path, period):
    rate, amplitude, seconds = 1.4, 8.0, 20.0
    found = session_metrics(trace_of(tmp_path, stroking(seconds, rate, amplitude, period), period=period))
    gain = 1 / (1 + (rate / 10.0) ** 4)  # of the low pass, twice second order
    omega, cycles = 2 * np.pi * rate, rate * seconds
    assert found.duration == pytest.approx(seconds)
    assert found.strokes == 2 * cycles + 1  # it begins and ends in the middle of one
    assert found.stroke_rate == pytest.approx(2 * rate, rel=0.02)
    assert found.path == pytest.approx(4 * amplitude * gain * cycles, rel=2e-3)
    assert found.mean_speed == pytest.approx(4 * amplitude * gain * rate, rel=5e-3)
    assert found.peak_speed == pytest.approx(amplitude * omega * gain, rel=5e-3)
    assert found.rms_jerk == pytest.approx(amplitude * gain * omega**3 / np.sqrt(2), rel=0.02)
    normalised = np.sqrt(0.5 * (amplitude * gain * omega**3) ** 2 / 2 * seconds**6) / found.path
    assert found.normalised_jerk == pytest.approx(normalised, rel=0.02)
    pytest.importorskip("pandas", reason="extra `pandas` is not installed")
    row = found.to_dataframe().iloc[0]
    assert (row.duration_s, row.path_mm, row.threshold_N) == (found.duration, found.path, 2.0)


def test_tremor_and_pauses_are_no_strokes(tmp_path):
    random = np.random.default_rng(1)
    steady = stroking(10, 0.5, 8.0)
    time = np.arange(len(steady)) / 1000
    shaking = steady + 0.2 * np.sin(2 * np.pi * 9.0 * time)[:, None] + random.normal(0, 0.05, steady.shape)
    paused = np.concatenate([steady[:4400], np.repeat(steady[4400:4401], 3000, axis=0), steady[4400:]])
    for motion in (steady, shaking, paused):
        assert session_metrics(trace_of(tmp_path, motion)).strokes == 11
        (tmp_path / "session.h5").unlink()


def test_the_hysteresis_decides_what_is_a_stroke(tmp_path):
    trace = trace_of(tmp_path, stroking(10, 1.0, 0.8))
    assert [session_metrics(trace, hysteresis=mm).strokes for mm in (1.5, 1.7)] == [19, 0]


def test_strokes_are_counted_between_first_and_last_contact(tmp_path):
    motion = stroking(20, 1.0, 8.0)
    touching = np.zeros(len(motion))
    touching[5000:15000] = 1
    found = session_metrics(trace_of(tmp_path, motion, touching=touching))
    assert found.strokes in (20, 21)
    assert (found.stroke_rate, found.contact) == (pytest.approx(2.0, rel=0.06), pytest.approx(10.0))


def test_a_still_burr(tmp_path):
    found = session_metrics(trace_of(tmp_path, np.zeros((2000, 3))))
    assert (found.strokes, found.peak_speed, found.path, found.rms_jerk) == (0, 0.0, 0.0, 0.0)
    assert np.isnan(found.normalised_jerk)
    assert found.to_dict()["normalised_jerk"] is None


def test_forces_are_weighted_by_the_time_of_their_tick(tmp_path):
    force, touching, k = np.zeros((1000, 3)), np.zeros(1000), np.ones(1000)
    force[:200], touching[:200], k[:200] = (0.0, 0.0, 3.0), 1, 4
    force[200:600], touching[200:600] = (0.6, 0.0, 0.8), 1
    trace = trace_of(tmp_path, np.zeros((1000, 3)), sent=force, touching=touching, k=k)
    found = session_metrics(trace)
    due = {
        "duration": 1.6, "contact": 1.2, "mean_force": (3.0 * 0.8 + 1.0 * 0.4) / 1.2,
        "rms_force": np.sqrt((9.0 * 0.8 + 1.0 * 0.4) / 1.2), "peak_force": 3.0, "over_threshold": 0.8,
    }  # fmt: skip
    assert {name: getattr(found, name) for name in due} == pytest.approx(due)
    assert session_metrics(trace, threshold=0.9).over_threshold == pytest.approx(1.2)
    assert session_metrics(trace, threshold=3.0).over_threshold == 0


def test_removed_volume_is_the_bones_own(tmp_path):
    bone = small_bone()
    records = make_records(bone, 1500)
    found = session_metrics(recorded(tmp_path / "session.h5", records))
    assert found.removed == pytest.approx(bone.removed - small_bone().removed)
    cutting = (records["k"] * (records["burr"]["removed"][:, 0] > 0)).sum() / 1000
    assert 0 < found.cutting < found.duration
    assert (found.cutting, found.removal_rate, found.series["removed"][-1]) == (
        pytest.approx(cutting), pytest.approx(found.removed / cutting), found.removed,
    )  # fmt: skip


def test_a_late_tick_moves_no_faster(tmp_path):
    """Positions belong to the time that ticks stand for, so lost deadlines change no speed."""
    whole = stroking(10, 1.0, 8.0)
    k = np.ones(len(whole), dtype=int)
    keep = np.ones(len(whole), dtype=bool)
    for at in range(100, len(whole) - 10, 50):
        keep[at : at + 4] = False
        k[at + 4] = 5
    found = session_metrics(trace_of(tmp_path, whole[keep], k=k[keep]))
    assert (found.duration, found.peak_speed, found.strokes) == (
        pytest.approx(10.0), pytest.approx(8.0 * 2 * np.pi, rel=5e-3), 21,
    )  # fmt: skip


@pytest.mark.parametrize("ticks", [0, 1, 40])
def test_a_session_too_short_for_its_motion_says_so(tmp_path, ticks):
    found = session_metrics(trace_of(tmp_path, np.zeros((ticks, 3))))
    assert (found.duration, found.to_dict()["path_mm"]) == (pytest.approx(ticks / 1000), None)
    assert np.isnan([found.path, found.mean_speed, found.rms_jerk]).all()
    found.plot()


@pytest.mark.parametrize(
    ("ask", "error", "sentence"),
    [
        *((lambda trace, options=options: session_metrics(trace, **options), ValueError, words) for options, words in [
            ({"threshold": 0}, "threshold must be positive, got 0"),
            ({"hysteresis": float("nan")}, "hysteresis must be positive, got nan"),
            ({"burr": 1}, "burr must be an index below 1, got 1"),
        ]),
        *((lambda _, ask=ask: ask("session.h5"), TypeError,
            r"trace must be a Trace, as load_trace gives it, got 'session\.h5'") for ask in (session_metrics, replay)),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path, ask, error, sentence):
    trace = trace_of(tmp_path, np.zeros((10, 3)))
    with pytest.raises(error, match=sentence):
        ask(trace)
