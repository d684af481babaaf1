"""Velocity-force curves: their rules, and CSV files good and bad."""

import io
import math
import sys

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from burrlab import materials
from burrlab._core import Burr
from burrlab.measured.curve import VelocityCurve
from burrlab.measured.synthetic import synthetic_curve
from burrlab.theory.continuum import penetration_velocity

mpl.use("Agg")

NAN = float("nan")
HEADER = "force_N,velocity_mm_s\n"


def read(text: str) -> VelocityCurve:
    return VelocityCurve.from_csv(io.StringIO(text))


def written(curve: VelocityCurve) -> str:
    stream = io.StringIO()
    curve.to_csv(stream)
    return stream.getvalue()


class TestCurve:
    def test_arrays_are_read_only_copies(self):
        force = np.array([1.0, 2.0])
        curve = VelocityCurve(force, [0.5, 1.5])
        force[0] = 9.0
        assert curve.force[0] == 1.0
        with pytest.raises(ValueError, match="read-only"):
            curve.force[0] = 3.0

    def test_ok_needs_a_velocity_and_a_fine_status(self):
        curve = VelocityCurve([1, 2, 3, 4], [0.1, NAN, 0.3, 0.4], status=["ok", "ok", "excluded", ""])
        assert curve.ok.tolist() == [True, False, False, True]
        assert VelocityCurve([1, 2], [0.1, NAN]).ok.tolist() == [True, False]

    def test_provenance_is_plain(self):
        curve = VelocityCurve([1], [1], provenance={"voxel": (0.1, 0.2), "n": np.int64(3), "a": np.ones(2)})
        assert curve.provenance == {"voxel": [0.1, 0.2], "n": 3, "a": [1.0, 1.0]}

    def test_equality(self):
        a = VelocityCurve([1, 2], [0.1, NAN], source="x")
        assert a == VelocityCurve([1, 2], [0.1, NAN], source="x")
        assert a != VelocityCurve([1, 2], [0.1, 0.2], source="x")
        assert a != VelocityCurve([1, 2], [0.1, NAN], sigma=[1, 1], source="x")
        assert a != "x"

    @pytest.mark.parametrize(
        ("arguments", "match"),
        [
            ({"force": [], "velocity": []}, "at least one row"),
            ({"force": [1, 2], "velocity": [1]}, "velocity must have 2 values, one a force: got 1"),
            ({"force": [[1]], "velocity": [1]}, "force must have one dimension"),
            (
                {"force": [1, NAN], "velocity": [1, 1]},
                "row 1, force: must be a finite number above 0, in N: got nan",
            ),
            ({"force": [0], "velocity": [1]}, "row 0, force: must be a finite number above 0, in N: got 0"),
            ({"force": [1], "velocity": [-1]}, "row 0, velocity: .*above 0, in mm/s: got -1"),
            ({"force": [1], "velocity": [math.inf]}, "row 0, velocity: must be a finite number"),
            ({"force": [1], "velocity": [1], "sigma": [0]}, "row 0, sigma: .*above 0"),
            ({"force": [1], "velocity": [1], "window_start": [0.5]}, "window_end.*missing"),
            (
                {"force": [1], "velocity": [1], "window_start": [1], "window_end": [0.5]},
                "below the window's end of 0.5",
            ),
            (
                {"force": [1], "velocity": [1], "window_start": [NAN], "window_end": [1]},
                "both its ends or neither",
            ),
            ({"force": [1], "velocity": [1], "status": ["a\nb"]}, "one line of text"),
            ({"force": [1], "velocity": [1], "radius": 0}, "radius must be a finite number above 0"),
        ],
    )
    def test_bad_input(self, arguments, match):
        with pytest.raises(ValueError, match=match):
            VelocityCurve(**arguments)

    def test_shows_itself(self):
        curve = VelocityCurve([1, 2], [0.1, NAN], status=["ok", "a<b"], source="bench")
        assert repr(curve) == "VelocityCurve(2 rows, 1 with a velocity, 1..2 N, 'bench')"
        assert "<th>velocity_mm_s</th>" in curve._repr_html_()
        assert "a&lt;b" in curve._repr_html_()

    def test_plot(self):
        from matplotlib import pyplot

        curve = VelocityCurve([1, 2, 3], [0.1, NAN, 0.3], sigma=[0.01, NAN, 0.02], source="synthetic, seed 1")
        ax = curve.plot(log=True)
        assert ax.get_xlabel() == "force [N]"
        assert ax.get_ylabel() == "penetration velocity [mm/s]"
        assert ax.get_xscale() == ax.get_yscale() == "log"
        assert curve.plot(ax) is ax
        assert ax.lines[0].get_label() == "synthetic data"
        assert ax.lines[0].get_xdata().tolist() == [1, 3]
        pyplot.close(ax.figure)

    def test_to_frame(self):
        pandas = pytest.importorskip("pandas")
        frame = VelocityCurve([1, 2], [0.1, NAN], status=["ok", "stalled"]).to_frame()
        assert list(frame.columns) == ["force_N", "velocity_mm_s", "status"]
        assert isinstance(frame, pandas.DataFrame)

    def test_to_frame_without_pandas(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "pandas", None)
        with pytest.raises(ImportError, match=r"to_frame needs pandas: pip install 'burrlab\[pandas\]'"):
            VelocityCurve([1], [1]).to_frame()


class TestReading:
    def test_columns_in_any_order(self):
        curve = read("status,velocity_mm_s,sigma_mm_s,force_N\nok,0.5,0.01,1\nstalled,,,2\n")
        assert curve.force.tolist() == [1, 2]
        assert curve.sigma is not None
        assert curve.ok.tolist() == [True, False]
        assert curve.status == ("ok", "stalled")

    def test_comments_blank_lines_bom_and_crlf(self):
        head = "\ufeff# bench 3\n\n# source: my rig\nforce_N, velocity_mm_s\n"
        text = (head + "# between\n1 , 0.5\n\n2,1.5\n").replace("\n", "\r\n")
        curve = VelocityCurve.from_csv(io.BytesIO(text.encode()))
        assert curve.source == "my rig"
        assert curve.velocity.tolist() == [0.5, 1.5]

    def test_source_is_the_file_name_where_none_is_given(self, tmp_path):
        path = tmp_path / "bench.csv"
        path.write_text(HEADER + "1,0.5\n")
        assert VelocityCurve.from_csv(path).source == "bench.csv"

    def test_text_as_provenance(self):
        assert read(f"# provenance: donor 12\n{HEADER}1,0.5\n").provenance == {"note": "donor 12"}

    @pytest.mark.parametrize(
        ("text", "match"),
        [
            ("", "CSV text: the file is empty"),
            ("# only this\n\n", "CSV text: the file is empty"),
            (HEADER, "CSV text: there is no row below the column names"),
            ("force_N\n1\n", "line 1: column velocity_mm_s is missing"),
            ("velocity_mm_s,status\n1,ok\n", "line 1: column force_N is missing"),
            (
                "# a\nforce_N,velocity\n1,1\n",
                "line 2: unknown column 'velocity'; known are force_N, velocity_mm_s, ",
            ),
            ("force_N,velocity_mm_s,force_N\n1,1,1\n", "line 1: column force_N is there twice"),
            (
                "force_N,velocity_mm_s,window_start_mm\n1,1,0.5\n",
                "column window_start_mm needs column window_end_mm",
            ),
            (
                "force_N,velocity_mm_s,window_end_mm\n1,1,0.5\n",
                "column window_end_mm needs column window_start_mm",
            ),
            ("force_N;velocity_mm_s\n1;1\n", "line 1: the separator must be a comma, not semicolons"),
            ("force_N\tvelocity_mm_s\n1\t1\n", "line 1: the separator must be a comma, not tabs"),
            (HEADER + "# c\n1,0.5\n2,fast\n", "line 4, column velocity_mm_s: 'fast' is not a number"),
            (HEADER + "1_0,0.5\n", "line 2, column force_N: '1_0' is not a number"),
            (
                HEADER + "1,0\n",
                "line 2, column velocity_mm_s: must be a finite number above 0, in mm/s: got 0.0",
            ),
            (HEADER + "1,-0.5\n", "line 2, column velocity_mm_s: must be .* got -0.5"),
            (HEADER + "1,inf\n", "line 2, column velocity_mm_s: must be a finite number"),
            (HEADER + "1,nan\n", "line 2, column velocity_mm_s: must be a finite number, or empty"),
            (HEADER + "0,0.5\n", "line 2, column force_N: must be a finite number above 0, in N"),
            (HEADER + ",0.5\n", "line 2, column force_N: every row needs a force"),
            (HEADER + "1,0.5,2\n", r"line 2: 2 fields are due \(force_N, velocity_mm_s\), found 3"),
            (HEADER + "1\n", "line 2: 2 fields are due .* found 1"),
            (HEADER + '1,"0.5\n', "line 2: not a line of comma-separated fields"),
            ("force_N,velocity_mm_s,sigma_mm_s\n1,1,0\n", "line 2, column sigma_mm_s: .* above 0"),
            (
                "force_N,velocity_mm_s,window_start_mm,window_end_mm\n1,1,1,0.5\n",
                "line 2, column window_start_mm: must be below the window's end of 0.5 mm: got 1.0",
            ),
            (
                "force_N,velocity_mm_s,window_start_mm,window_end_mm\n1,1,,1\n",
                "line 2, column window_start_mm: a window needs both its ends or neither",
            ),
            (
                f"# radius_mm: big\n{HEADER}1,1\n",
                "radius_mm in the comments must be a finite number above 0: got 'big'",
            ),
        ],
    )
    def test_bad_files(self, text, match):
        with pytest.raises(ValueError, match=match):
            read(text)

    @pytest.mark.parametrize(
        ("content", "match"),
        [(b"\x89PNG\r\n\x1a\n\xff\xfe", "not a text file in UTF-8"), (b"force_N\0,", "it holds zero bytes")],
    )
    def test_binary_files(self, tmp_path, content, match):
        path = tmp_path / "image.csv"
        path.write_bytes(content)
        with pytest.raises(ValueError, match=f"image.csv: .*{match}"):
            VelocityCurve.from_csv(path)

    def test_no_such_file(self, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"nowhere\.csv"):
            VelocityCurve.from_csv(tmp_path / "nowhere.csv")


positive = st.floats(min_value=5e-324, max_value=1.7e308)
line = st.text(st.characters(exclude_categories=["C", "Z"]) | st.just(" ")).map(
    lambda text: " ".join(text.split())
)


@st.composite
def curves(draw: st.DrawFn) -> VelocityCurve:
    n = draw(st.integers(1, 6))

    def column(values: st.SearchStrategy[float]) -> list[float]:
        return draw(st.lists(values, min_size=n, max_size=n))

    windows = column(
        st.just((NAN, NAN)) | st.tuples(positive, positive).map(sorted).filter(lambda w: w[0] < w[1])
    )
    has_windows = draw(st.booleans())
    return VelocityCurve(
        column(positive),
        column(positive | st.just(NAN)),
        sigma=draw(st.none() | st.just(column(positive | st.just(NAN)))),
        window_start=[w[0] for w in windows] if has_windows else None,
        window_end=[w[1] for w in windows] if has_windows else None,
        status=draw(st.none() | st.just(column(line))),
        source=draw(line),
        provenance=draw(
            st.dictionaries(st.text(), st.none() | st.booleans() | st.integers() | positive | st.text())
        ),
        radius=draw(st.none() | positive),
    )


@given(curves())
def test_csv_round_trip_is_without_loss(curve):
    assert read(written(curve)) == curve


def test_csv_round_trip_through_a_file(tmp_path):
    curve = synthetic_curve(Burr(3.0), materials["pvc"], [0.1, 0.5, 2.0], seed=4)
    curve.to_csv(tmp_path / "curve.csv")
    assert VelocityCurve.from_csv(tmp_path / "curve.csv") == curve
    assert b"\r" not in (tmp_path / "curve.csv").read_bytes()


class TestSynthetic:
    def test_says_so(self):
        curve = synthetic_curve(Burr(3.0), materials["bone"], [1.0, 2.0, 5.0], seed=7)
        assert curve.source.startswith("synthetic, seed 7")
        assert written(curve).startswith("# source: synthetic, seed 7")
        assert curve.provenance["synthetic"] is True
        assert curve.status == ("ok",) * 6 + ("overloaded",) * 3  # 0.1925 c_e R^2 = 3.7 N

    def test_without_scatter_it_is_the_mean_field(self):
        force = np.array([0.3, 1.0, 2.5])
        curve = synthetic_curve(Burr(3.0), materials["bone"], force, repeats=2, scatter=0, seed=1)
        expected = np.repeat(penetration_velocity(Burr(3.0), materials["bone"], force), 2)
        np.testing.assert_allclose(curve.velocity, expected, rtol=1e-12)

    def test_scatter_is_log_normal(self):
        curve = synthetic_curve(Burr(3.0), materials["bone"], [1.0], repeats=4000, scatter=0.08, seed=1)
        log = np.log(curve.velocity / penetration_velocity(Burr(3.0), materials["bone"], 1.0))
        # z-limit 4.9: false alarm 1e-6 a comparison
        assert abs(log.mean()) < 4.9 * 0.08 / np.sqrt(4000)
        assert abs(log.std() / 0.08 - 1) < 4.9 / np.sqrt(2 * 4000)

    def test_a_seed_makes_a_curve_and_a_row(self):
        bone, burr = materials["bone"], Burr(3.0)
        one = synthetic_curve(burr, bone, [1.0, 2.0], seed=3)
        assert one == synthetic_curve(burr, bone, [1.0, 2.0], seed=3)
        assert one != synthetic_curve(burr, bone, [1.0, 2.0], seed=4)
        fewer = synthetic_curve(burr, bone, [1.0, 2.0], repeats=2, seed=3)
        assert fewer.velocity.tolist() == one.velocity[[0, 1, 3, 4]].tolist()

    def test_a_drawn_seed_is_recorded(self):
        curve = synthetic_curve(Burr(3.0), materials["bone"], [1.0])
        assert curve == synthetic_curve(Burr(3.0), materials["bone"], [1.0], seed=curve.provenance["seed"])

    @pytest.mark.parametrize(
        ("arguments", "match"),
        [
            ({"forces": [1, -1]}, "forces must be finite and above 0 N"),
            ({"forces": [NAN]}, "forces must be finite and above 0 N"),
            ({"forces": [1], "repeats": 0}, "repeats must be at least 1: got 0"),
            ({"forces": [1], "scatter": -0.1}, "scatter must be finite and not negative: got -0.1"),
        ],
    )
    def test_bad_input(self, arguments, match):
        with pytest.raises(ValueError, match=match):
            synthetic_curve(Burr(3.0), materials["bone"], **arguments)
