"""Depth-time records: their rules, CSV files, segments and how well they are known, synthetic records."""

import io
import math
import sys

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.signal import lfilter
from scipy.stats import binom

import burrlab
from burrlab import materials
from burrlab._core import Burr
from burrlab.measured.depth_trace import DepthTrace, rising, slope_error
from burrlab.measured.synthetic import synthetic_trace
from burrlab.theory.closed_forms import penetration_velocity_between
from burrlab.theory.continuum import mean_field_descent, penetration_velocity

mpl.use("Agg")

NAN = float("nan")
HEADER = "time_s,immersion_mm\n"
TIME = np.arange(21) * 0.1
RISE = 0.5 + 0.025 * np.arange(21)  # 0.25 mm/s from R/6 to R/3
ROWS = "".join(f"{t!r},{h!r}\n" for t, h in zip(TIME.tolist(), RISE.tolist(), strict=True))


def read(text: str, **arguments: float) -> DepthTrace:
    return DepthTrace.from_csv(io.StringIO(text), **arguments)


def written(trace: DepthTrace) -> str:
    stream = io.StringIO()
    trace.to_csv(stream)
    return stream.getvalue()


def autoregression(random: np.random.Generator, n: int, rho: float) -> np.ndarray:
    """Stationary noise of standard deviation 1."""
    start = [rho * random.standard_normal()]
    return lfilter([math.sqrt(1 - rho**2)], [1, -rho], random.standard_normal(n), zi=start)[0]


class TestTrace:
    def test_arrays_are_read_only_copies(self):
        immersion = RISE.copy()
        trace = DepthTrace(TIME, immersion, 1, 3)
        immersion[0] = 9.0
        assert trace.immersion[0] == 0.5
        with pytest.raises(ValueError, match="read-only"):
            trace.time[0] = 3.0

    def test_default_window(self):
        trace = DepthTrace(TIME, RISE, 1, 3)
        assert (trace.start_mm, trace.end_mm) == (0.5, 1.0)
        early = DepthTrace(TIME, RISE - 0.52, 1, 1.44)  # begins out of contact
        assert (early.start_mm, early.end_mm) == pytest.approx((0.24, 0.48))
        late = DepthTrace(TIME, RISE + 0.1, 1, 3)
        assert (late.start_mm, late.end_mm) == (0.6, 1.0)
        short = DepthTrace(TIME, RISE - 0.1, 1, 3)
        assert (short.start_mm, short.end_mm) == (0.5, 0.9)

    def test_equality(self):
        one = DepthTrace(TIME, RISE, 1, 3, source="x")
        assert one == DepthTrace(TIME, RISE, 1, 3, 0.5, 1.0, source="x")
        assert one != DepthTrace(TIME, RISE, 2, 3, source="x")
        assert one != DepthTrace(TIME, RISE, 1, 3, 0.6, source="x")
        assert one != "x"

    @pytest.mark.parametrize(
        ("arguments", "match"),
        [
            ({"time": [TIME]}, "time must have one dimension"),
            ({"immersion": RISE[1:]}, "immersion must have 21 values, one a time: got 20"),
            ({"time": TIME[:9], "immersion": RISE[:9]}, "a depth trace needs at least 10 samples: got 9"),
            ({"force": 0}, "force must be a finite number above 0, in N: got 0.0"),
            ({"radius": math.inf}, "radius must be a finite number above 0, in mm: got inf"),
            ({"time": np.append(TIME[:-1], NAN)}, "row 20, time: must be a finite number, in s: got nan"),
            (
                {"immersion": np.append(-math.inf, RISE[1:])},
                "row 0, immersion: must be a finite number, in mm: got -inf",
            ),
            (
                {"time": np.append(TIME[:-1], TIME[-2])},
                r"row 20, time: must be above the 1\.9\d* s of the row before: got 1\.9",
            ),
            ({"start_mm": 1.0}, "the window must have 0 < start_mm < end_mm <= R: got 1.0 and 1.0"),
            ({"start_mm": NAN}, "the window must have 0 < start_mm < end_mm <= R: got nan and 1.0"),
            ({"start_mm": 0.0}, "the window must have 0 < start_mm < end_mm <= R: got 0.0"),
            ({"end_mm": 3.1}, "the window must have 0 < start_mm < end_mm <= R: got 0.5 and 3.1"),
            ({"end_mm": 1.1}, "end_mm must not lie beyond the deepest immersion of 1 mm: got 1.1"),
            ({"immersion": RISE[::-1]}, "the window must have .* got 1.0 and 1.0"),
            (
                {"immersion": np.append(RISE[:-1], 0.5)},
                "immersion must rise from start_mm on: at 2 s it lies 0.475 mm above what it had reached",
            ),
            (
                {"start_mm": 0.801},
                "a depth trace needs at least 10 samples in its window, 0.801 to 1 mm: got 8",
            ),
        ],
    )
    def test_bad_input(self, arguments, match):
        with pytest.raises(ValueError, match=match):
            DepthTrace(**{"time": TIME, "immersion": RISE, "force": 1, "radius": 3, **arguments})

    def test_shows_itself(self):
        trace = DepthTrace(TIME, RISE, 1, 3, source="a<b")
        assert repr(trace) == "DepthTrace(21 samples, 1 N, R = 3 mm, 0.5..1 mm, 'a<b')"
        assert "a&lt;b" in trace._repr_html_()
        assert "<th>force_N</th>" in trace._repr_html_()
        assert len(trace) == 21

    def test_plot(self):
        from matplotlib import pyplot

        trace = synthetic_trace(Burr(3.0), materials["bone"], 1.0, seed=1)
        ax = trace.plot(n=3)
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("time [s]", "immersion [mm]")
        assert ax.lines[0].get_label() == "synthetic data"
        slopes = [np.polyfit(*drawn.get_data(), 1)[0] for drawn in ax.lines[1:]]
        np.testing.assert_allclose(slopes, trace.segments(3).velocity, rtol=1e-9)
        assert trace.plot(ax) is ax
        assert ax.yaxis_inverted()
        pyplot.close(ax.figure)

    def test_to_frame(self):
        pytest.importorskip("pandas")
        assert list(DepthTrace(TIME, RISE, 1, 3).to_frame().columns) == ["time_s", "immersion_mm"]

    def test_to_frame_without_pandas(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "pandas", None)
        with pytest.raises(ImportError, match="to_frame needs pandas"):
            DepthTrace(TIME, RISE, 1, 3).to_frame()


class TestFromDescent:
    def test_force_held_exactly(self):
        run = burrlab.descend(Burr(3.0), materials["bone"], 1.0, voxel=0.2, ideal=True, seed=1)
        trace = DepthTrace.from_descent(run)
        assert (trace.force, trace.radius, (trace.start_mm, trace.end_mm)) == (1.0, 3.0, run.window)
        assert np.array_equal(trace.time, run.time)
        assert trace.provenance["seed"] == 1
        assert trace.segments(1).velocity[0] == pytest.approx(run.penetration_velocity, rel=2e-3)

    def test_controller_and_rig_begin_out_of_contact(self):
        run = burrlab.descend(Burr(3.0), materials["bone"], 0.75, voxel=0.2, seed=1)
        trace = DepthTrace.from_descent(run)
        assert trace.immersion[0] < 0
        segments = trace.segments()
        expected = [
            penetration_velocity(Burr(3.0), materials["bone"], 0.75, *window)
            for window in zip(segments.start_mm, segments.end_mm, strict=True)
        ]
        np.testing.assert_allclose(segments.velocity, expected, rtol=0.05)

    def test_a_run_without_descent(self):
        run = burrlab.descend(Burr(3.0), materials["bone"], 5.0, voxel=0.4, ideal=True, seed=1)
        assert run.status == "overloaded"
        with pytest.raises(ValueError, match="a depth trace needs at least 10 samples: got 0"):
            DepthTrace.from_descent(run)


class TestReading:
    def test_comments(self):
        text = f"# force_N: 1.5\n# radius_mm: 3\n# window_mm: 0.6 0.9\n# source: bench\n{HEADER}{ROWS}"
        trace = read(text)
        assert (trace.force, trace.radius, trace.start_mm, trace.end_mm) == (1.5, 3.0, 0.6, 0.9)
        assert trace.source == "bench"
        assert read(text, force=1.5, radius=3.0) == trace

    def test_columns_in_any_order(self):
        turned = "".join(",".join(reversed(row.split(","))) + "\n" for row in ROWS.split())
        assert read("immersion_mm,time_s\n" + turned, force=1, radius=3).immersion.tolist() == RISE.tolist()

    @pytest.mark.parametrize(
        ("text", "match"),
        [
            ("", "CSV text: the file is empty"),
            ("time_s\n1\n", "line 1: column immersion_mm is missing"),
            ("immersion_mm\n1\n", "line 1: column time_s is missing"),
            (
                "time_s,immersion_mm,force_N\n1,1,1\n",
                "unknown column 'force_N'; known are time_s, immersion_mm",
            ),
            (HEADER + ",1\n", "line 2, column time_s: every row needs a time"),
            (HEADER + "1,\n", "line 2, column immersion_mm: every row needs an immersion"),
            (HEADER + "1,inf\n", "line 2, column immersion_mm: must be a finite number, in mm: got inf"),
            ("# force_N: 2\n" + HEADER + ROWS, "force must be the 2.0 of the comment .* got 1.0"),
            ("# radius_mm: 2\n" + HEADER + ROWS, "radius must be the 2.0 of the comment .* got 3.0"),
            ("# force_N: no\n" + HEADER + ROWS, "force_N in the comments must be .* got 'no'"),
            (
                "# window_mm: 0.5\n" + HEADER + ROWS,
                "window_mm in the comments must be two numbers, start and end: got '0.5'",
            ),
            (
                "# window_mm: 0.5 R/3\n" + HEADER + ROWS,
                "window_mm in the comments must be two numbers, start and end: got '0.5 R/3'",
            ),
            (HEADER + ROWS + "2,1.1\n", r"CSV text: row 21, time: must be above the 2\.0 s"),
        ],
    )
    def test_bad_files(self, text, match):
        with pytest.raises(ValueError, match=match):
            read(text, force=1.0, radius=3.0)

    @pytest.mark.parametrize(
        ("arguments", "match"),
        [
            ({"radius": 3}, "the force is unknown: add the comment '# force_N: ...' or give force="),
            ({"force": 1}, "the radius is unknown: add the comment '# radius_mm: ...' or give radius="),
        ],
    )
    def test_what_is_unknown(self, arguments, match):
        with pytest.raises(ValueError, match=match):
            read(HEADER + ROWS, **arguments)

    def test_no_such_file(self, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"nowhere\.csv"):
            DepthTrace.from_csv(tmp_path / "nowhere.csv")


line = st.text(st.characters(exclude_categories=["C", "Z"]) | st.just(" ")).map(
    lambda text: " ".join(text.split())
)


@given(
    arrays.arrays(float, 15, elements=st.floats(1e-9, 1.0)),
    arrays.arrays(float, 15, elements=st.floats(0.0, 1e-3)),
    st.floats(5e-324, 1.7e308),
    st.sampled_from([None, 0.55]),
    line,
    st.dictionaries(st.text(), st.none() | st.booleans() | st.integers() | st.text()),
)
def test_csv_round_trip_is_without_loss(gaps, noise, force, start, source, provenance):
    immersion = np.linspace(0.5, 1.0, 15) + noise
    trace = DepthTrace(np.cumsum(gaps), immersion, force, 3, start, None, source, provenance)
    assert read(written(trace)) == trace


def test_csv_round_trip_through_a_file(tmp_path):
    trace = synthetic_trace(Burr(3.0), materials["pvc"], 0.2, seed=4)
    trace.to_csv(tmp_path / "trace.csv")
    assert DepthTrace.from_csv(tmp_path / "trace.csv") == trace
    assert b"\r" not in (tmp_path / "trace.csv").read_bytes()


class TestRising:
    def test_a_rising_record_is_itself(self):
        time = np.linspace(0, 1, 500)
        immersion = 0.4 + 0.9 * time - 0.3 * time**2
        np.testing.assert_allclose(rising(immersion), immersion, rtol=0, atol=5e-6)
        assert np.array_equal(rising(immersion)[1:-1], immersion[1:-1])

    @pytest.mark.parametrize("end", [0.995, 0.999, 1.0, 1.003])
    def test_steps_are_joined(self, end):
        immersion = np.linspace(0.503, end, 5000)
        stepped = 0.01 * np.round(immersion / 0.01)
        np.testing.assert_allclose(rising(stepped), immersion, rtol=0, atol=2e-4)

    def test_noise_does_not_bring_a_depth_forward(self):
        immersion = np.linspace(0.5, 1.0, 20000)
        noisy = immersion + 0.002 * np.random.default_rng(1).standard_normal(20000)
        assert np.argmax(noisy >= 0.7) < 8000 - 120  # three standard deviations, 0.006 mm
        # 160 samples lie within two standard deviations; the count of those below has a deviation near 7
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
            ("bone", 0.3, 1.0, 5),
            ("bone", 1.0, 1.0, 1),
            ("bone", 1.0, 1.0, 5),
            ("bone", 1.0, 1.0, 10),
            ("bone", 2.0, 0.25, 5),  # static contact is beyond R/6
            ("pvc", 0.2, 1.0, 5),
        ],
    )
    def test_agree_with_the_model(self, material, force, sample_ms, n):
        burr = Burr(3.0)
        trace = synthetic_trace(
            burr, materials[material], force, run_scatter=0, noise=0, step=0, sample_ms=sample_ms, seed=1
        )
        segments = trace.segments(n)
        expected = [
            penetration_velocity(burr, materials[material], force, *window)
            for window in zip(segments.start_mm, segments.end_mm, strict=True)
        ]
        np.testing.assert_allclose(segments.velocity, expected, rtol=3e-3)

    def test_one_segment_without_noise_is_the_penetration_velocity(self):
        trace = synthetic_trace(Burr(3.0), materials["bone"], 1.0, noise=0, step=0, seed=1)
        whole = penetration_velocity_between(trace.time, trace.immersion, trace.start_mm, trace.end_mm)
        assert trace.segments(1).velocity[0] == pytest.approx(whole, rel=1e-5)

    @pytest.mark.parametrize(
        ("n", "match"),
        [
            (0, "n must be at least 1: got 0"),
            (
                5,
                "n must leave at least 6 samples in each segment, there are 5 between 0.5 and 0.6 mm: got 5",
            ),
        ],
    )
    def test_bad_number(self, n, match):
        with pytest.raises(ValueError, match=match):
            DepthTrace(TIME, RISE, 1, 3).segments(n)

    def test_a_record_that_stands_still(self):
        immersion = np.repeat([0.5, 1.0], 20)
        trace = DepthTrace(np.arange(40) * 0.1, immersion, 1, 3, start_mm=0.99)
        with pytest.raises(ValueError, match="n must leave segments in which the immersion rises, it stands"):
            trace.segments(1)


def slopes(n: int, rho: float, repeats: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the slope of a bent line of 0.1 mm with noise of 2 um, and what `slope_error` says of them."""
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
            (1000, 0.5, 0.94),
            (1000, 0.9, 0.93),
            (200, 0.9, 0.85),  # ten independent samples
            (30, 0.0, 0.90),
        ],
    )
    def test_covers_the_slope(self, n, rho, covered):
        repeats = 1500
        error, told = slopes(n, rho, repeats)
        inside = int(np.count_nonzero(np.abs(error) < 1.96 * told))
        assert inside >= binom.ppf(1e-6, repeats, covered)
        # neither does it exaggerate: a variance of 1500 draws has a relative deviation of sqrt(2/1500)
        assert np.mean(told**2) < 2 * np.mean(error**2) * (1 + 4.9 * math.sqrt(2 / repeats))

    def test_makes_up_for_what_the_quadratic_took(self):
        repeats = 6000
        error, told = slopes(200, 0.9, repeats)
        # within a tenth; both deviate by about 1 % from draw to draw: z-limit 4.9
        limit = 4.9 * math.hypot(
            1 / math.sqrt(2 * repeats), 1.25 * told.std() / told.mean() / math.sqrt(repeats)
        )
        assert abs(np.median(told) / error.std() - 1) < 0.1 + limit

    def test_gives_no_credit_for_neighbours_that_differ(self):
        time = np.arange(100) * 1e-3
        told = slope_error(time, 1e-3 * (-1.0) ** np.arange(100))
        x = time - time.mean()
        assert told == pytest.approx(1e-3 * math.sqrt(100 / 97) / math.sqrt(x @ x), rel=1e-3)

    def test_is_the_ordinary_one_for_white_noise(self):
        n = 4000
        told = slopes(n, 0.0, 20)[1]
        x = np.arange(n) * 1e-3
        ordinary = 0.002 / math.sqrt(np.sum((x - x.mean()) ** 2))
        # rho's deviation of 1/sqrt(n) moves one error by as much at most: z-limit 4.9
        np.testing.assert_allclose(told, ordinary, rtol=4.9 * math.sqrt((1 + 0.5) / n))

    def test_nothing_left_nothing_unsure(self):
        assert slope_error(np.arange(6.0), np.zeros(6)) == 0.0


class TestSyntheticStatistics:
    """Whole records with noise, read to 10 um: biases and errors of the segments."""

    @pytest.mark.parametrize(("force", "noise"), [(1.0, 0.002), (1.0, 0.0005), (1.0, 0.0), (2.0, 0.002)])
    def test_segments(self, force, noise):
        burr, bone, repeats = Burr(3.0), materials["bone"], 120
        window = mean_field_descent(burr, bone, force).window()
        error, told = [], []
        for seed in range(repeats):
            # the same run, rate and all, without and with noise and steps
            clean = synthetic_trace(burr, bone, force, noise=0, step=0, seed=seed)
            read_out = synthetic_trace(burr, bone, force, noise=noise, seed=seed)
            true, found = (
                DepthTrace(trace.time, trace.immersion, force, 3.0, *window).segments()
                for trace in (clean, read_out)
            )
            error.append(np.log(found.velocity / true.velocity))
            told.append(found.log_sigma)
        error, told = np.array(error), np.array(told)
        # 0.5 % of bias are allowed, 1 % at twenty samples a segment; z-limit 4.9: false alarm 1e-6
        allowed = 0.005 if force == 1.0 else 0.01
        limit = allowed + 4.9 * error.std(axis=0) / math.sqrt(repeats)
        assert (np.abs(error.mean(axis=0)) < limit).all()
        inside = np.count_nonzero(np.abs(error) < 1.96 * told)
        assert inside >= binom.ppf(1e-6, error.size, 0.95)


class TestSynthetic:
    burr, bone = Burr(3.0), materials["bone"]

    def test_says_so(self):
        trace = synthetic_trace(self.burr, self.bone, 1.0, seed=7)
        assert trace.source.startswith("synthetic, seed 7: bone")
        assert trace.provenance["synthetic"] is True
        assert (trace.provenance["step_mm"], trace.provenance["run_scatter"]) == (0.01, 0.08)
        assert (trace.force, trace.radius, trace.start_mm, trace.end_mm) == (1.0, 3.0, 0.5, 1.0)

    def test_read_in_steps_from_static_contact_to_the_end(self):
        trace = synthetic_trace(self.burr, self.bone, 1.0, noise=0, seed=7)
        steps = trace.immersion / 0.01
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
        assert trace.immersion[0] == pytest.approx(0.42)  # R (F/(c_e R^2))^(2/3) = 0.417 mm
        assert trace.immersion[-1] == pytest.approx(1.0)
        np.testing.assert_allclose(np.diff(trace.time), 1e-3)

    def test_noise(self):
        clean = synthetic_trace(self.burr, self.bone, 0.5, noise=0, step=0, seed=3)
        noisy = synthetic_trace(self.burr, self.bone, 0.5, noise=0.002, step=0, seed=3)
        z = (noisy.immersion - clean.immersion) / 0.002
        # z-limit 4.9: false alarm 1e-6 a comparison
        assert abs(z.mean()) < 4.9 / math.sqrt(len(z))
        assert abs(z.std() - 1) < 4.9 / math.sqrt(2 * len(z))
        assert abs(z[1:] @ z[:-1] / (z @ z)) < 4.9 / math.sqrt(len(z))

    def test_a_run_has_its_own_rate(self):
        def duration(seed: int, scatter: float) -> float:
            trace = synthetic_trace(
                self.burr, self.bone, 1.0, run_scatter=scatter, noise=0, step=0, seed=seed
            )
            return float(trace.time[-1])

        steady = duration(0, 0)
        log = np.log([duration(seed, 0.08) / steady for seed in range(400)])
        # z-limit 4.9: false alarm 1e-6 a comparison; a sample is 0.1 % of the duration
        assert abs(log.mean()) < 4.9 * 0.08 / math.sqrt(400) + 1e-3
        assert abs(log.std() / 0.08 - 1) < 4.9 / math.sqrt(2 * 400) + 1e-3

    def test_a_seed_makes_a_record(self):
        one = synthetic_trace(self.burr, self.bone, 1.0, seed=3)
        assert one == synthetic_trace(self.burr, self.bone, 1.0, seed=3)
        assert one != synthetic_trace(self.burr, self.bone, 1.0, seed=4)

    def test_a_drawn_seed_is_recorded(self):
        trace = synthetic_trace(self.burr, self.bone, 1.0)
        assert trace == synthetic_trace(self.burr, self.bone, 1.0, seed=trace.provenance["seed"])

    @pytest.mark.parametrize(
        ("arguments", "match"),
        [
            ({"run_scatter": -0.1}, "run_scatter must be finite and not negative: got -0.1"),
            ({"noise": NAN}, "noise must be finite and not negative: got nan"),
            ({"step": -1}, "step must be finite and not negative: got -1"),
            ({"sample_ms": 0}, "sample_ms must be finite and above 0: got 0"),
            ({"sample_ms": 120}, "a depth trace needs at least 10 samples: got 9"),
            ({"force": -1}, "force must be positive and finite"),
            ({"force": 4}, r"force must be below c_e R\^2"),
        ],
    )
    def test_bad_input(self, arguments, match):
        with pytest.raises(ValueError, match=match):
            synthetic_trace(self.burr, self.bone, **{"force": 1.0, "seed": 1, **arguments})
