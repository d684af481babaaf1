"""Static indentation: its rules, CSV files good and bad, synthetic data."""

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
from burrlab.measured.indentation import Indentation
from burrlab.measured.synthetic import synthetic_indentation

mpl.use("Agg")

NAN = float("nan")
HEADER = "force_N,depth_mm\n"


def read(text: str, radius: float | None = 5.0) -> Indentation:
    return Indentation.from_csv(io.StringIO(text), radius=radius)


def written(data: Indentation) -> str:
    stream = io.StringIO()
    data.to_csv(stream)
    return stream.getvalue()


class TestIndentation:
    def test_arrays_are_read_only_copies(self):
        depth = np.array([0.1, 0.2])
        data = Indentation([1, 2], depth, 5)
        depth[0] = 9.0
        assert data.depth[0] == 0.1
        with pytest.raises(ValueError, match="read-only"):
            data.force[0] = 3.0

    def test_equality(self):
        one = Indentation([1, 2], [0.1, 0.2], 5, sigma=[0.1, NAN])
        assert one == Indentation([1, 2], [0.1, 0.2], 5, sigma=[0.1, NAN])
        assert one != Indentation([1, 2], [0.1, 0.2], 4, sigma=[0.1, NAN])
        assert one != Indentation([1, 2], [0.1, 0.2], 5)
        assert one != "x"

    @pytest.mark.parametrize(
        ("arguments", "match"),
        [
            ({"force": [], "depth": []}, "an indentation needs at least one row"),
            ({"force": [[1]]}, "force must have one dimension"),
            ({"force": [1, 2]}, "depth must have 2 values, one a force: got 1"),
            ({"sigma": [1, 2]}, "sigma must have 1 values, one a force: got 2"),
            ({"force": [NAN]}, "row 0, force: must be a finite number above 0, in N: got nan"),
            ({"force": [-1]}, "row 0, force: must be a finite number above 0, in N: got -1.0"),
            ({"depth": [0]}, "row 0, depth: must be a finite number above 0, in mm: got 0.0"),
            ({"depth": [NAN]}, "row 0, depth: must be a finite number above 0, in mm: got nan"),
            ({"sigma": [math.inf]}, "row 0, sigma: must be a finite number above 0, in N: got inf"),
            ({"depth": [10]}, "row 0, depth: must be below 2R = 10 mm: got 10.0"),
            ({"radius": 0}, "radius must be a finite number above 0, in mm: got 0.0"),
            ({"radius": NAN}, "radius must be a finite number above 0, in mm: got nan"),
        ],
    )
    def test_bad_input(self, arguments, match):
        with pytest.raises(ValueError, match=match):
            Indentation(**{"force": [1], "depth": [0.1], "radius": 5, **arguments})

    def test_shows_itself(self):
        data = Indentation([1, 2], [0.1, 0.2], 5, sigma=[0.1, NAN], source="a<b")
        assert repr(data) == "Indentation(2 rows, R = 5 mm, 1..2 N at 0.1..0.2 mm, 'a<b')"
        assert "<th>sigma_N</th>" in data._repr_html_()
        assert "a&lt;b" in data._repr_html_()
        assert len(data) == 2

    def test_plot(self):
        from matplotlib import pyplot

        data = Indentation([1, 2], [0.1, 0.2], 5, sigma=[0.1, NAN], source="synthetic, seed 1")
        ax = data.plot()
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("depth [mm]", "force [N]")
        assert ax.get_xscale() == ax.get_yscale() == "linear"
        assert ax.lines[0].get_label() == "synthetic data"
        assert ax.lines[0].get_xdata().tolist() == [0.1, 0.2]
        assert data.plot(ax, log=True) is ax
        assert ax.get_xscale() == ax.get_yscale() == "log"
        pyplot.close(ax.figure)

    def test_to_frame(self):
        pytest.importorskip("pandas")
        assert list(Indentation([1], [0.1], 5, sigma=[0.1]).to_frame().columns) == [
            "force_N",
            "depth_mm",
            "sigma_N",
        ]

    def test_to_frame_without_pandas(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "pandas", None)
        with pytest.raises(ImportError, match="to_frame needs pandas"):
            Indentation([1], [0.1], 5).to_frame()


class TestReading:
    def test_columns_in_any_order_and_unknown_sigma(self):
        data = read("sigma_N,depth_mm,force_N\n,0.1,1\n0.2,0.2,2\n")
        assert (data.force.tolist(), data.depth.tolist()) == ([1, 2], [0.1, 0.2])
        assert np.array_equal(data.sigma, [NAN, 0.2], equal_nan=True)

    def test_radius_of_the_comment(self):
        text = f"# radius_mm: 4\n{HEADER}1,0.1\n"
        assert read(text, None).radius == 4
        assert read(text, 4.0).radius == 4

    def test_source_and_provenance(self, tmp_path):
        path = tmp_path / "bench.csv"
        path.write_text(f"# provenance: donor 12\n{HEADER}1,0.1\n")
        data = Indentation.from_csv(path, radius=5)
        assert (data.source, data.provenance) == ("bench.csv", {"note": "donor 12"})

    @pytest.mark.parametrize(
        ("text", "radius", "match"),
        [
            ("", 5.0, "CSV text: the file is empty"),
            (HEADER, 5.0, "there is no row below the column names"),
            ("force_N\n1\n", 5.0, "line 1: column depth_mm is missing"),
            ("depth_mm\n1\n", 5.0, "line 1: column force_N is missing"),
            (
                "force_N,depth_mm,status\n1,1,ok\n",
                5.0,
                "unknown column 'status'; known are force_N, depth_mm",
            ),
            ("force_N;depth_mm\n1;1\n", 5.0, "the separator must be a comma, not semicolons"),
            (HEADER + ",0.1\n", 5.0, "line 2, column force_N: every row needs a force"),
            (HEADER + "1,\n", 5.0, "line 2, column depth_mm: every row needs a depth"),
            (HEADER + "1,deep\n", 5.0, "line 2, column depth_mm: 'deep' is not a number"),
            (
                HEADER + "1,-1\n",
                5.0,
                "line 2, column depth_mm: must be a finite number above 0, in mm: got -1.0",
            ),
            (HEADER + "1,0.1\n1,10\n", 5.0, "CSV text: row 1, depth: must be below 2R = 10 mm: got 10.0"),
            (
                HEADER + "1,1\n",
                None,
                "the radius is unknown: add the comment '# radius_mm: ...' or give radius=",
            ),
            (
                f"# radius_mm: 4\n{HEADER}1,1\n",
                5.0,
                "radius must be the 4.0 of the comment '# radius_mm:' in the file: got 5.0",
            ),
            (f"# radius_mm: big\n{HEADER}1,1\n", 5.0, "radius_mm in the comments must be .*: got 'big'"),
            (HEADER + "1,1\n", -5.0, "CSV text: radius must be a finite number above 0, in mm: got -5.0"),
        ],
    )
    def test_bad_files(self, text, radius, match):
        with pytest.raises(ValueError, match=match):
            read(text, radius)

    def test_no_such_file(self, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"nowhere\.csv"):
            Indentation.from_csv(tmp_path / "nowhere.csv")


positive = st.floats(min_value=5e-324, max_value=1.7e308)
line = st.text(st.characters(exclude_categories=["C", "Z"]) | st.just(" ")).map(
    lambda text: " ".join(text.split())
)


@st.composite
def indentations(draw: st.DrawFn) -> Indentation:
    n = draw(st.integers(1, 6))
    radius = draw(st.floats(1e-3, 1e3))

    def column(values: st.SearchStrategy[float]) -> list[float]:
        return draw(st.lists(values, min_size=n, max_size=n))

    return Indentation(
        column(positive),
        column(st.floats(5e-324, 2 * radius, exclude_max=True)),
        radius,
        sigma=draw(st.none() | st.just(column(positive | st.just(NAN)))),
        source=draw(line),
        provenance=draw(st.dictionaries(st.text(), st.none() | st.booleans() | st.integers() | st.text())),
    )


@given(indentations())
def test_csv_round_trip_is_without_loss(data):
    assert read(written(data), None) == data


def test_csv_round_trip_through_a_file(tmp_path):
    data = synthetic_indentation(Burr(5.0), materials["bone"], [0.02, 0.1], repeats=3, seed=4)
    data.to_csv(tmp_path / "press.csv")
    assert Indentation.from_csv(tmp_path / "press.csv") == data
    assert b"\r" not in (tmp_path / "press.csv").read_bytes()


class TestSynthetic:
    burr, bone = Burr(5.0), materials["bone"]

    def test_says_so(self):
        data = synthetic_indentation(self.burr, self.bone, [0.1], seed=7)
        assert data.source.startswith("synthetic, seed 7: bone")
        assert data.provenance["synthetic"] is True
        assert (data.radius, data.provenance["scatter"], data.provenance["c_e"]) == (5.0, 0.1, self.bone.c_e)

    def test_without_scatter_it_is_eq_3(self):
        depth = np.array([0.01, 0.1, 1.0, 9.9])
        data = synthetic_indentation(self.burr, self.bone, depth, repeats=2, scatter=0, seed=1)
        expected = 2.145 * 25 * (np.repeat(depth, 2) / 5) ** 1.5
        np.testing.assert_allclose(data.force, expected, rtol=1e-14)
        assert data.depth.tolist() == np.repeat(depth, 2).tolist()

    def test_scatter_is_log_normal(self):
        data = synthetic_indentation(self.burr, self.bone, [0.1], repeats=4000, seed=1)
        log = np.log(data.force / (2.145 * 25 * 0.02**1.5))
        # z-limit 4.9: false alarm 1e-6 a comparison
        assert abs(log.mean()) < 4.9 * 0.1 / np.sqrt(4000)
        assert abs(log.std() / 0.1 - 1) < 4.9 / np.sqrt(2 * 4000)

    def test_a_seed_makes_a_row(self):
        one = synthetic_indentation(self.burr, self.bone, [0.1, 0.2], repeats=3, seed=3)
        fewer = synthetic_indentation(self.burr, self.bone, [0.1, 0.2, 0.3], repeats=2, seed=3)
        assert fewer.force[:4].tolist() == one.force[[0, 1, 3, 4]].tolist()
        assert one != synthetic_indentation(self.burr, self.bone, [0.1, 0.2], repeats=3, seed=4)

    def test_a_drawn_seed_is_recorded(self):
        data = synthetic_indentation(self.burr, self.bone, [0.1])
        again = synthetic_indentation(self.burr, self.bone, [0.1], seed=data.provenance["seed"])
        assert data == again

    @pytest.mark.parametrize(
        ("arguments", "match"),
        [
            ({"depths": [0.1, 0]}, "depths must be above 0 and below 2R = 10 mm: got"),
            ({"depths": [10]}, "depths must be above 0 and below 2R = 10 mm: got"),
            ({"depths": [NAN]}, "depths must be above 0 and below 2R = 10 mm: got"),
            ({"depths": [1], "repeats": 0}, "repeats must be at least 1: got 0"),
            ({"depths": [1], "scatter": -0.1}, "scatter must be finite and not negative: got -0.1"),
        ],
    )
    def test_bad_input(self, arguments, match):
        with pytest.raises(ValueError, match=match):
            synthetic_indentation(self.burr, self.bone, **arguments)
