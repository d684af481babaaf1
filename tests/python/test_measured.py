"""Curves, indentations and depth traces: rules, CSV files, synthetic data; segments and their errors."""

import io
import math
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.signal import lfilter
from scipy.stats import binom
from session_scenes import refused

from burrlab import (
    Burr,
    DepthTrace,
    Indentation,
    VelocityCurve,
    descend,
    materials,
    mean_field_descent,
    penetration_velocity,
    synthetic_curve,
    synthetic_indentation,
    synthetic_trace,
)
from burrlab.measured.depth_trace import rising, slope_error

NAN = float("nan")
BURR, BONE = Burr(3.0), materials["bone"]
TIME = np.arange(21) * 0.1
RISE = 0.5 + 0.025 * np.arange(21)  # 0.25 mm/s from R/6 to R/3
ROWS = "".join(f"{t!r},{h!r}\n" for t, h in zip(TIME.tolist(), RISE.tolist(), strict=True))
CURVE, PRESS, TRACE = "force_N,velocity_mm_s\n", "force_N,depth_mm\n", "time_s,immersion_mm\n"
SOUND: dict[type, dict[str, Any]] = {
    VelocityCurve: {"force": [1], "velocity": [1]},
    Indentation: {"force": [1], "depth": [0.1], "radius": 5},
    DepthTrace: {"time": TIME, "immersion": RISE, "force": 1, "radius": 3},
}
GIVEN: dict[type, dict[str, float]] = {
    VelocityCurve: {},
    Indentation: {"radius": 5.0},
    DepthTrace: {"force": 1.0, "radius": 3.0},
}
WINDOW = "force_N,velocity_mm_s,window_start_mm,window_end_mm\n"


def read(kind: Any, text: str, **arguments: Any) -> Any:
    return kind.from_csv(io.StringIO(text), **arguments)


def written(data: Any) -> str:
    stream = io.StringIO()
    data.to_csv(stream)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("kind", "same", "other"),
    [
        (VelocityCurve, {"velocity": [NAN]}, [{"velocity": [1]}, {"sigma": [1]}, {"source": "x"}]),
        (Indentation, {"sigma": [NAN]}, [{"sigma": None}, {"radius": 4}]),
        (DepthTrace, {"start_mm": 0.5, "end_mm": 1.0}, [{"force": 2}, {"start_mm": 0.6}]),
    ],
)
def test_equality_is_by_value(kind: Any, same: dict[str, Any], other: list[dict[str, Any]]) -> None:
    sound = {**SOUND[kind], **same}
    one = kind(**sound)
    assert one == kind(**sound)
    assert all(one != kind(**{**sound, **changed}) for changed in other)
    assert one != "x"
    assert kind is not DepthTrace or one == DepthTrace(**SOUND[kind])
    name, given = next((n, np.array(v, float)) for n, v in sound.items())
    data = kind(**{**sound, name: given})
    given[0] = 9.0  # columns are read-only copies
    assert data == one
    with pytest.raises(ValueError, match="read-only"):
        getattr(data, name)[0] = 3.0


def test_what_a_curve_keeps() -> None:
    curve = VelocityCurve([1, 2, 3, 4], [0.1, NAN, 0.3, 0.4], status=["ok", "OK", "excluded", ""])
    assert curve.ok.tolist() == [True, False, False, True]
    lost = VelocityCurve(
        [1, 2, 3], [0.1, NAN, NAN], status=["OK", "too slow", "OVERLOADED"]
    )  # without a limit
    assert (lost.ok.tolist(), lost.status) == ([True, False, False], ("ok", "too slow", "overloaded"))
    curve = VelocityCurve([1], [1], provenance={"voxel": (0.1, 0.2), "n": np.int64(3), "a": np.ones(2)})
    assert curve.provenance == {"voxel": [0.1, 0.2], "n": 3, "a": [1.0, 1.0]}


@pytest.mark.parametrize(
    ("shift", "radius", "window"),
    [(0, 3, (0.5, 1.0)), (-0.52, 1.44, (0.24, 0.48)), (0.1, 3, (0.6, 1.0)), (-0.1, 3, (0.5, 0.9))],
    ids=["whole", "begins out of contact", "late", "short"],
)
def test_default_window(shift: float, radius: float, window: tuple[float, float]) -> None:
    trace = DepthTrace(TIME, RISE + shift, 1, radius)
    assert (trace.start_mm, trace.end_mm) == pytest.approx(window)


@pytest.mark.parametrize(
    ("kind", "changed", "match"),
    [
        (VelocityCurve, {"force": [], "velocity": []}, "a velocity curve needs at least one row"),
        (VelocityCurve, {"force": [1, 2]}, "velocity must have 2 values, one a force: got 1"),
        (VelocityCurve, {"force": np.ma.array([1.0, 2.0], mask=[False, True])}, "force must have no masked numbers"),
        (VelocityCurve, {"force": [[1]]}, "force must have one dimension"),
        (VelocityCurve, {"force": [1, NAN], "velocity": [1, 1]},
         "row 2, force: must be a finite number above 0, in N: got nan"),
        (VelocityCurve, {"velocity": [-1]}, "row 1, velocity: .*above 0, in mm/s: got -1"),
        (VelocityCurve, {"velocity": [math.inf]}, "row 1, velocity: must be a finite number"),
        (VelocityCurve, {"window_start": [0.5]}, "window_end.*missing"),
        (VelocityCurve, {"window_start": [1], "window_end": [0.5]}, "below the window's end of 0.5"),
        (VelocityCurve, {"window_start": [NAN], "window_end": [1]}, "both its ends or neither"),
        (VelocityCurve, {"status": ["a\nb"]}, "one line of text"),
        (VelocityCurve, {"radius": 0}, "radius must be a finite number above 0"),
        (Indentation, {"depth": [0]}, "row 1, depth: must be a finite number above 0, in mm: got 0.0"),
        (Indentation, {"sigma": [math.inf]}, "row 1, sigma: must be a finite number above 0, in N: got inf"),
        (Indentation, {"depth": [10]}, "row 1, depth: must be below 2R = 10 mm: got 10.0"),
        (DepthTrace, {"time": TIME[:9], "immersion": RISE[:9]},
         "a depth trace needs at least 10 samples: got 9"),
        (DepthTrace, {"force": 0}, "force must be a finite number above 0, in N: got 0.0"),
        (DepthTrace, {"time": np.append(TIME[:-1], NAN)},
         "row 21, time: must be a finite number, in s: got nan"),
        (DepthTrace, {"immersion": np.append(-math.inf, RISE[1:])},
         "row 1, immersion: must be a finite number, in mm: got -inf"),
        (DepthTrace, {"time": np.append(TIME[:-1], TIME[-2])}, r"row 21, time: must be above the 1\.9\d* s of the row before: got 1\.9"),
        (DepthTrace, {"start_mm": 1.0}, "the window must have 0 < start_mm < end_mm <= R: got 1.0 and 1.0"),
        (DepthTrace, {"end_mm": 3.1}, "the window must have 0 < start_mm < end_mm <= R: got 0.5 and 3.1"),
        (DepthTrace, {"end_mm": 1.1}, "end_mm must not lie beyond the deepest immersion of 1 mm: got 1.1"),
        (DepthTrace, {"immersion": RISE[::-1]}, "the window must have .* got 1.0 and 1.0"),
        (DepthTrace, {"immersion": np.append(RISE[:-1], 0.5)},
         "immersion must rise from start_mm on: at 2 s it lies 0.475 mm above"),
        (DepthTrace, {"start_mm": 0.801},
         "a depth trace needs at least 10 samples in its window, 0.801 to 1 mm: got 8"),
    ],
)  # fmt: skip
def test_bad_numbers(kind: Any, changed: dict[str, Any], match: str) -> None:
    refused((lambda: kind(**{**SOUND[kind], **changed}), match))


@pytest.mark.parametrize(
    ("data", "text", "column"),
    [
        (VelocityCurve([1, 2], [0.1, NAN], status=["ok", "a<b"], source="bench"),
         "VelocityCurve(2 rows, 1 with a velocity, 1..2 N, 'bench')", "velocity_mm_s"),
        (Indentation([1, 2], [0.1, 0.2], 5, sigma=[0.1, NAN], source="a<b"),
         "Indentation(2 rows, R = 5 mm, 1..2 N at 0.1..0.2 mm, 'a<b')", "sigma_N"),
        (DepthTrace(TIME, RISE, 1, 3, source="a<b"),
         "DepthTrace(21 samples, 1 N, R = 3 mm, 0.5..1 mm, 'a<b')", "force_N"),
    ],
)  # fmt: skip
def test_they_show_themselves(data: Any, text: str, column: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert repr(data) == text
    assert f"<th>{column}</th>" in data._repr_html_()
    assert "a&lt;b" in data._repr_html_()
    pytest.importorskip("pandas")
    names = written(data).split("# ")[-1].splitlines()[1].split(",")
    assert list(data.to_dataframe().columns) == names
    monkeypatch.setitem(sys.modules, "pandas", None)
    refused((data.to_dataframe, r"to_dataframe needs pandas: pip install 'burrlab\[pandas\]'", ImportError))


@pytest.mark.parametrize(
    ("data", "x"),
    [
        (
            VelocityCurve([1, 2, 3], [0.1, NAN, 0.3], sigma=[0.01, NAN, 0.02], source="synthetic, seed 1"),
            [1, 3],
        ),
        (Indentation([1, 2], [0.1, 0.2], 5, sigma=[0.1, NAN], source="synthetic, seed 1"), [0.1, 0.2]),
    ],
)
def test_plots(data: Any, x: list[float]) -> None:
    ax = data.plot(log=True)
    assert (ax.lines[0].get_label(), ax.lines[0].get_xdata().tolist()) == ("synthetic data", x)
    assert ax.get_xscale() == ax.get_yscale() == "log"


def test_the_plot_of_a_trace_has_the_slopes_of_its_segments() -> None:
    trace = synthetic_trace(BURR, BONE, 1.0, seed=1)
    ax = trace.plot(n=3)
    slopes = [np.polyfit(*drawn.get_data(), 1)[0] for drawn in ax.lines[1:]]
    np.testing.assert_allclose(slopes, trace.segments(3).velocity, rtol=1e-9)
    assert ax.yaxis_inverted()


def test_comments_blank_lines_bom_and_crlf() -> None:
    head = "\ufeff# bench 3\n\n# source: my rig\nforce_N, velocity_mm_s\n"
    text = (head + "# between\n1 , 0.5\n\n2,1.5\n").replace("\n", "\r\n")
    curve = VelocityCurve.from_csv(io.BytesIO(text.encode()))
    assert (curve.source, curve.velocity.tolist()) == ("my rig", [0.5, 1.5])
    assert VelocityCurve([1], [0.5], source="my rig,").source == "my rig"  # a spreadsheet adds such commas
    comments = "# force_N: 1.5\n# radius_mm: 3\n# window_mm: 0.6 0.9\n# provenance: donor 12\n"
    trace = read(DepthTrace, comments + TRACE + ROWS)
    assert (trace.force, trace.radius, trace.start_mm, trace.end_mm) == (1.5, 3.0, 0.6, 0.9)
    assert (trace.source, trace.provenance) == ("CSV text", {"note": "donor 12"})
    assert read(DepthTrace, comments + TRACE + ROWS, force=1.5, radius=3.0) == trace


@pytest.mark.parametrize(
    ("kind", "text", "arguments", "match"),
    [
        *((kind, text, GIVEN[kind], match) for kind, text, match in [
            (VelocityCurve, "", "CSV text: the file is empty"),
            (VelocityCurve, CURVE, "CSV text: there is no row below the column names"),
            (VelocityCurve, "force_N\n1\n", "line 1: column velocity_mm_s is missing"),
            (VelocityCurve, "# a\nforce_N,velocity\n1,1\n",
             "line 2: unknown column 'velocity'; known are force_N, velocity_mm_s, "),
            (VelocityCurve, "force_N,velocity_mm_s,force_N\n1,1,1\n",
             "line 1: column force_N is there twice"),
            (VelocityCurve, "force_N,velocity_mm_s,window_start_mm\n1,1,0.5\n",
             "column window_start_mm needs column window_end_mm"),
            (VelocityCurve, "force_N;velocity_mm_s\n1;1\n",
             "line 1: the separator must be a comma, not semicolons"),
            (VelocityCurve, "force_N\tvelocity_mm_s\n1\t1\n",
             "line 1: the separator must be a comma, not tabs"),
            (VelocityCurve, CURVE + "# c\n1,0.5\n2,fast\n",
             "line 4, column velocity_mm_s: 'fast' is not a number"),
            (VelocityCurve, CURVE + "1_0,0.5\n", "line 2, column force_N: '1_0' is not a number"),
            (VelocityCurve, CURVE + "nan,1\n", "line 2, column force_N: must be a finite number above 0, in N: got nan"),
            (VelocityCurve, CURVE + ",0.5\n", "line 2, column force_N: every row needs a force"),
            (VelocityCurve, CURVE + "1,0.5,2\n", r"line 2: 2 fields are due \(force_N, velocity_mm_s\), found 3"),
            (VelocityCurve, CURVE.replace("\n", ",\n") + "1,0.5,,\n", r"line 2: 2 fields are due \(.*\), found 4"),
            (VelocityCurve, CURVE + '1,"0.5\n', "line 2: not a line of comma-separated fields"),
            (VelocityCurve, WINDOW + "1,1,1,0.5\n",
             "line 2, column window_start_mm: must be below the window's end of 0.5 mm: got 1.0"),
            (VelocityCurve, f"# radius_mm: 3_0\n{CURVE}1,1\n",
                                "radius_mm in the comments must be a finite number above 0: got '3_0'"),
            (Indentation, "force_N\n1\n", "line 1: column depth_mm is missing"),
            (Indentation, PRESS + "1,\n", "line 2, column depth_mm: every row needs a depth"),
            (Indentation, PRESS + "1,0.1\n1,10\n",
             "CSV text: row 2, depth: must be below 2R = 10 mm: got 10.0"),
            (Indentation, f"# radius_mm: 4\n{PRESS}1,1\n",
             "radius must be the 4.0 of the comment '# radius_mm:' in the file: got 5.0"),
            (DepthTrace, "time_s\n1\n", "line 1: column immersion_mm is missing"),
            (DepthTrace, TRACE + "1,\n", "line 2, column immersion_mm: every row needs an immersion"),
            (DepthTrace, "# force_N: 2\n" + TRACE + ROWS, "force must be the 2.0 of the comment .* got 1.0"),
            (DepthTrace, "# force_N: no\n" + TRACE + ROWS, "force_N in the comments must be .* got 'no'"),
            (DepthTrace, "# window_mm: 0.5\n" + TRACE + ROWS,
             "window_mm in the comments must be two numbers, start and end: got '0.5'"),
            (DepthTrace, TRACE + ROWS + "2,1.1\n", r"CSV text: row 22, time: must be above the 2\.0 s"),
        ]),
        (Indentation, PRESS + "1,1\n", {},
         "the radius is unknown: add the comment '# radius_mm: ...' or give radius="),
        (Indentation, PRESS + "1,1\n", {"radius": -5.0},
         "CSV text: radius must be a finite number above 0, in mm: got -5.0"),
        (DepthTrace, TRACE + ROWS, {"radius": 3},
         "the force is unknown: add the comment '# force_N: ...' or give force="),
    ],
)  # fmt: skip
def test_bad_files(kind: Any, text: str, arguments: dict[str, float], match: str) -> None:
    refused((lambda: read(kind, text, **arguments), match))


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "not a text file in UTF-8"), (b"force_N\0,", "it holds zero bytes"),
        (b"1," * 1_000_000, "a line must have at most 1048576 characters, got one of 2000000"),
    ],
)  # fmt: skip
def test_files_that_are_no_text(tmp_path: Any, content: bytes, match: str) -> None:
    (tmp_path / "image.csv").write_bytes(content)
    refused(
        (lambda: VelocityCurve.from_csv(tmp_path / "image.csv"), f"image.csv: .*{match}"),
        *((lambda kind=kind: kind.from_csv(tmp_path / "nowhere.csv"), r"nowhere\.csv", FileNotFoundError) for kind in SOUND),
    )  # fmt: skip


positive = st.floats(min_value=5e-324, max_value=1.7e308)
line = st.text(st.characters(exclude_categories=["C", "Z"]) | st.just(" ")).map(
    lambda text: " ".join(text.split())
)
provenances = st.dictionaries(st.text(), st.none() | st.booleans() | st.integers() | positive | st.text())


@st.composite
def data_sets(draw: st.DrawFn) -> Any:
    n, radius = draw(st.integers(1, 6)), draw(st.floats(1e-3, 1e3))

    def column(values: st.SearchStrategy[Any]) -> Any:
        return draw(st.lists(values, min_size=n, max_size=n))

    common = {"source": draw(line), "provenance": draw(provenances)}
    sigma = draw(st.none() | st.just(column(positive | st.just(NAN))))
    kind = draw(st.sampled_from([VelocityCurve, Indentation, DepthTrace]))
    if kind is Indentation:
        return Indentation(
            column(positive),
            column(st.floats(5e-324, 2 * radius, exclude_max=True)),
            radius,
            sigma=sigma,
            **common,
        )
    if kind is DepthTrace:
        gaps = draw(arrays.arrays(float, 15, elements=st.floats(1e-9, 1.0)))
        noise = draw(arrays.arrays(float, 15, elements=st.floats(0.0, 1e-3)))
        start = draw(st.sampled_from([None, 0.55]))
        return DepthTrace(
            np.cumsum(gaps), np.linspace(0.5, 1.0, 15) + noise, draw(positive), 3, start, **common
        )
    windows = column(
        st.just((NAN, NAN)) | st.tuples(positive, positive).map(sorted).filter(lambda w: w[0] < w[1])
    )
    ends = [list(end) for end in zip(*windows, strict=True)] if draw(st.booleans()) else [None, None]
    status = draw(st.none() | st.just(column(line)))
    return VelocityCurve(
        column(positive),
        column(positive | st.just(NAN)),
        sigma,
        *ends,
        status,
        radius=draw(st.none() | positive),
        **common,
    )


@settings(max_examples=50, deadline=None)
@given(data_sets())
def test_csv_round_trip_is_without_loss(data: Any) -> None:
    assert read(type(data), written(data)) == data


# ---- synthetic data ----

MAKERS = [(synthetic_curve, ([1.0, 2.0],)), (synthetic_indentation, ([0.1, 0.2],)), (synthetic_trace, (1.0,))]


@pytest.mark.parametrize(("make", "arguments"), MAKERS)
def test_a_seed_makes_a_data_set_which_a_file_keeps(make: Any, arguments: Any, tmp_path: Any) -> None:
    one = make(BURR, BONE, *arguments, seed=3)
    assert one.source.startswith("synthetic, seed 3: bone")
    assert one.provenance["synthetic"] is True
    assert (one.radius, one.provenance["c_e"]) == (3.0, BONE.c_e)
    assert one == make(BURR, BONE, *arguments, seed=3)
    assert one != make(BURR, BONE, *arguments, seed=4)
    drawn = make(BURR, BONE, *arguments)
    assert drawn == make(BURR, BONE, *arguments, seed=drawn.provenance["seed"])
    one.to_csv(tmp_path / "data.csv")
    assert type(one).from_csv(tmp_path / "data.csv") == one
    content = (tmp_path / "data.csv").read_bytes()
    assert content.startswith(b"# source: synthetic, seed 3")
    assert b"\r" not in content
    (tmp_path / "data.csv").write_bytes(content.partition(b"\n")[2])
    assert type(one).from_csv(tmp_path / "data.csv").source == "data.csv"


def test_rows_of_a_seed_and_runs_without_a_number() -> None:
    one, fewer = (synthetic_curve(BURR, BONE, [1.0, 2.0], repeats=n, seed=3) for n in (3, 2))
    assert fewer.velocity.tolist() == one.velocity[[0, 1, 3, 4]].tolist()
    curve = synthetic_curve(BURR, BONE, [1.0, 2.0, 5.0], seed=7)
    assert curve.status == ("ok",) * 6 + ("overloaded",) * 3  # 0.1925 c_e R^2 = 3.7 N
    press, less = (
        synthetic_indentation(BURR, BONE, x, repeats=n, seed=3)
        for n, x in ((3, [0.1, 0.2]), (2, [0.1, 0.2, 0.3]))
    )
    assert less.force[:4].tolist() == press.force[[0, 1, 3, 4]].tolist()


def test_without_scatter_they_are_the_model() -> None:
    force = np.array([0.3, 1.0, 2.5])
    curve = synthetic_curve(BURR, BONE, force, repeats=2, scatter=0, seed=1)
    np.testing.assert_allclose(
        curve.velocity, np.repeat(penetration_velocity(BURR, BONE, force), 2), rtol=1e-12
    )
    depth = np.array([0.01, 0.1, 1.0, 5.9])
    press = synthetic_indentation(BURR, BONE, depth, repeats=2, scatter=0, seed=1)
    np.testing.assert_allclose(press.force, 2.145 * 9 * (np.repeat(depth, 2) / 3) ** 1.5, rtol=1e-14)
    assert press.depth.tolist() == np.repeat(depth, 2).tolist()


def log_normal(log: Any, scatter: float, within: float = 0.0) -> None:
    """Checks mean and scatter of logarithms; z-limit 4.9: false alarm 1e-6 a comparison."""
    assert abs(log.mean()) < 4.9 * scatter / np.sqrt(len(log)) + within
    assert abs(log.std() / scatter - 1) < 4.9 / np.sqrt(2 * len(log)) + within


def test_scatter_is_log_normal() -> None:
    curve = synthetic_curve(BURR, BONE, [1.0], repeats=2000, scatter=0.08, seed=1)
    log_normal(np.log(curve.velocity / penetration_velocity(BURR, BONE, 1.0)), 0.08)
    press = synthetic_indentation(BURR, BONE, [0.06], repeats=2000, seed=1)
    log_normal(np.log(press.force / (2.145 * 9 * 0.02**1.5)), 0.1)
    # for traces: noise of readings and rate of runs; a sample is 0.1 % of the duration
    clean, noisy = (synthetic_trace(BURR, BONE, 0.5, noise=noise, step=0, seed=3) for noise in (0, 0.002))
    z = (noisy.immersion - clean.immersion) / 0.002
    log_normal(z, 1.0)
    assert abs(z[1:] @ z[:-1] / (z @ z)) < 4.9 / math.sqrt(len(z))
    steady, *own = (
        synthetic_trace(BURR, BONE, 1.0, run_scatter=scatter, noise=0, step=0, seed=seed).time[-1]
        for scatter, seed in [(0, 0), *((0.08, seed) for seed in range(300))]
    )
    log_normal(np.log(np.array(own) / steady), 0.08, within=1e-3)


def test_a_synthetic_trace_is_read_in_steps_from_static_contact_to_the_end() -> None:
    trace = synthetic_trace(BURR, BONE, 1.0, noise=0, seed=7)
    steps = trace.immersion / 0.01
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert trace.immersion[0] == pytest.approx(0.42)  # R (F/(c_e R^2))^(2/3) = 0.417 mm
    assert trace.immersion[-1] == pytest.approx(1.0)
    np.testing.assert_allclose(np.diff(trace.time), 1e-3)
    assert (trace.provenance["step_mm"], trace.provenance["run_scatter"]) == (0.01, 0.08)


@pytest.mark.parametrize(
    ("make", "first", "options", "match"),
    [
        (synthetic_curve, [1, -1], {}, "forces must be finite and above 0 N"),
        (synthetic_curve, [1], {"repeats": 0}, "repeats must be at least 1: got 0"),
        (synthetic_curve, [1], {"scatter": -0.1}, "scatter must be finite and not negative: got -0.1"),
        (synthetic_indentation, [0.1, 0], {}, "depths must be above 0 and below 2R = 6 mm: got"),
        (synthetic_trace, 1.0, {"run_scatter": -0.1},
         "run_scatter must be finite and not negative: got -0.1"),
        (synthetic_trace, 1.0, {"noise": NAN}, "noise must be finite and not negative: got nan"),
        (synthetic_trace, 1.0, {"step": -1}, "step must be finite and not negative: got -1"),
        (synthetic_trace, 1.0, {"sample_ms": 0}, "sample_ms must be finite and above 0: got 0"),
        (synthetic_trace, 1.0, {"sample_ms": 120}, "a depth trace needs at least 10 samples: got 9"),
        (synthetic_trace, -1, {}, "force must be positive and finite"),
        (synthetic_trace, 4, {}, r"force must be below c_e R\^2"),
    ],
)  # fmt: skip
def test_bad_synthetic_data(make: Any, first: Any, options: dict[str, float], match: str) -> None:
    refused((lambda: make(BURR, BONE, first, seed=1, **options), match))


# ---- records of descents, and their segments ----


def autoregression(random: np.random.Generator, n: int, rho: float) -> np.ndarray:
    """Stationary noise with standard deviation 1."""
    start = [rho * random.standard_normal()]
    return lfilter([math.sqrt(1 - rho**2)], [1, -rho], random.standard_normal(n), zi=start)[0]


def test_a_record_of_controller_and_rig_begins_out_of_contact():
    run = descend(BURR, BONE, 0.75, voxel=0.2, seed=1)
    trace = DepthTrace(run.time, run.immersion, run.setpoint, run.burr.radius, *run.window)
    assert trace.immersion[0] < 0
    np.testing.assert_allclose(trace.segments().velocity, by_the_model(trace), rtol=0.05)


def by_the_model(trace: DepthTrace, n: int = 5, material: Any = BONE) -> list[Any]:
    """Velocities of the segments by the model [mm/s]."""
    segments = trace.segments(n)
    windows = zip(segments.start_mm, segments.end_mm, strict=True)
    return [penetration_velocity(BURR, material, trace.force, *window) for window in windows]


class TestRising:
    def test_a_rising_record_is_itself(self):
        time = np.linspace(0, 1, 500)
        immersion = 0.4 + 0.9 * time - 0.3 * time**2
        np.testing.assert_allclose(rising(immersion), immersion, rtol=0, atol=5e-6)
        assert np.array_equal(rising(immersion)[1:-1], immersion[1:-1])

    @pytest.mark.parametrize("end", [0.995, 0.999, 1.003])
    def test_steps_are_joined(self, end):
        immersion = np.linspace(0.503, end, 5000)
        np.testing.assert_allclose(rising(0.01 * np.round(immersion / 0.01)), immersion, rtol=0, atol=2e-4)

    def test_noise_does_not_bring_a_depth_forward(self):
        noisy = np.linspace(0.5, 1.0, 20000) + 0.002 * np.random.default_rng(1).standard_normal(20000)
        assert np.argmax(noisy >= 0.7) < 8000 - 120  # three standard deviations, 0.006 mm
        # 160 samples lie within two standard deviations; the count below has a deviation near 7
        assert abs(np.argmax(rising(noisy) >= 0.7) - 8000) < 35

    @given(arrays.arrays(float, st.integers(1, 30), elements=st.floats(-5, 5).map(lambda x: round(x, 1))))
    def test_never_falls(self, immersion):
        assert len(rising(immersion)) == len(immersion)
        assert (np.diff(rising(immersion)) >= -1e-12).all()


class TestSegments:
    def test_of_a_straight_record(self):
        segments = DepthTrace(np.arange(501) * 1e-3, 0.5 + 1e-3 * np.arange(501), 1, 3).segments(5)
        np.testing.assert_allclose(segments.start_mm, [0.5, 0.6, 0.7, 0.8, 0.9])
        np.testing.assert_allclose(segments.end_mm, [0.6, 0.7, 0.8, 0.9, 1.0])
        np.testing.assert_allclose(segments.velocity, 1.0, rtol=1e-9)
        assert (segments.log_sigma < 1e-9).all()
        assert set(segments.samples.tolist()) <= {100, 101}
        assert len(segments) == 5
        assert repr(segments) == "TraceSegments(5 between 0.500 and 1.000 mm: 1, 1, 1, 1, 1 mm/s)"
        with pytest.raises(ValueError, match="read-only"):
            segments.velocity[0] = 0

    @pytest.mark.parametrize(
        ("material", "force", "sample_ms", "n"),
        [
            (BONE, 0.3, 1.0, 5), (BONE, 1.0, 1.0, 1), (BONE, 1.0, 1.0, 10), (materials["pvc"], 0.2, 1.0, 5),
            (BONE, 2.0, 0.25, 5),  # static contact is beyond R/6
        ],
    )  # fmt: skip
    def test_agree_with_the_model(self, material, force, sample_ms, n):
        given = {"run_scatter": 0, "noise": 0, "step": 0, "sample_ms": sample_ms, "seed": 1}
        trace = synthetic_trace(BURR, material, force, **given)
        np.testing.assert_allclose(trace.segments(n).velocity, by_the_model(trace, n, material), rtol=3e-3)

    @pytest.mark.parametrize(
        ("trace", "n", "told"),
        [
            (DepthTrace(TIME, RISE, 1, 3), 0, "n must be at least 1: got 0"),
            (DepthTrace(TIME, RISE, 1, 3), 5,
             "5 segments need at least 6 samples each: the trace at 1 N has 5 between 0.5 and 0.6 mm"),
            (DepthTrace(np.arange(40) * 0.1, np.repeat([0.5, 1.0], 20), 1, 3, start_mm=0.99), 1,
             "n must leave segments in which the immersion rises, it stands"),
        ],
    )  # fmt: skip
    def test_bad_number(self, trace, n, told):
        refused((lambda: trace.segments(n), told))


def slopes(n: int, rho: float, repeats: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the slope of a bent line of 0.1 mm with noise of 2 um, and their `slope_error`."""
    random = np.random.default_rng(11)
    time = np.arange(n) * 1e-3
    centred = time - time.mean()
    line = 0.1 * time / time[-1] - 0.02 * (centred / time[-1]) ** 2
    records = [line + 0.002 * autoregression(random, n, rho) for _ in range(repeats)]
    found = [(record @ centred) / (centred @ centred) for record in records]
    return np.array(found) - 0.1 / time[-1], np.array([slope_error(time, record) for record in records])


class TestSlopeError:
    @pytest.mark.parametrize(
        ("n", "rho", "covered"),
        [
            (1000, 0.0, 0.94),
            (1000, 0.9, 0.93),
            (200, 0.9, 0.85),  # ten independent samples
            (30, 0.0, 0.90),
        ],
    )
    def test_covers_the_slope(self, n, rho, covered):
        repeats = 800
        error, told = slopes(n, rho, repeats)
        assert np.count_nonzero(np.abs(error) < 1.96 * told) >= binom.ppf(1e-6, repeats, covered)
        # not too large either: the variance of the draws has a relative deviation of sqrt(2/repeats)
        assert np.mean(told**2) < 2 * np.mean(error**2) * (1 + 4.9 * math.sqrt(2 / repeats))

    def test_makes_up_for_what_the_quadratic_took(self):
        repeats = 3000
        error, told = slopes(200, 0.9, repeats)
        # within a tenth; both vary by about 1.5 %: z-limit 4.9
        limit = 4.9 * math.hypot(
            1 / math.sqrt(2 * repeats), 1.25 * told.std() / told.mean() / math.sqrt(repeats)
        )
        assert abs(np.median(told) / error.std() - 1) < 0.1 + limit

    def test_gives_no_credit_for_neighbours_that_differ(self):
        time = np.arange(100) * 1e-3
        told = slope_error(time, 1e-3 * (-1.0) ** np.arange(100))
        x = time - time.mean()
        assert told == pytest.approx(1e-3 * math.sqrt(100 / 97) / math.sqrt(x @ x), rel=1e-3)

    def test_nothing_left_nothing_unsure(self):
        assert slope_error(np.arange(6.0), np.zeros(6)) == 0.0


@pytest.mark.parametrize(("force", "noise"), [(1.0, 0.002), (1.0, 0.0), (2.0, 0.002)])
def test_segments_of_whole_records(force, noise):
    """With noise, read to 10 um: biases and errors of the segments."""
    repeats, window = 80, mean_field_descent(BURR, BONE, force).window()
    error, told = [], []
    for seed in range(repeats):
        # the same run at the same rate, without and with noise and steps
        clean = synthetic_trace(BURR, BONE, force, noise=0, step=0, seed=seed)
        read_out = synthetic_trace(BURR, BONE, force, noise=noise, seed=seed)
        true, found = (
            DepthTrace(trace.time, trace.immersion, force, 3.0, *window).segments()
            for trace in (clean, read_out)
        )
        error.append(np.log(found.velocity / true.velocity))
        told.append(found.log_sigma)
    error, told = np.array(error), np.array(told)
    # a bias of 0.5 % is allowed, of 1 % with twenty samples a segment; z-limit 4.9: false alarm 1e-6
    allowed = 0.005 if force == 1.0 else 0.01
    limit = allowed + 4.9 * error.std(axis=0) / math.sqrt(repeats)
    assert (np.abs(error.mean(axis=0)) < limit).all()
    assert np.count_nonzero(np.abs(error) < 1.96 * told) >= binom.ppf(1e-6, error.size, 0.95)
