"""The next measurement: candidates off the ridge come first, and what is foretold of them comes true."""

import json
import sys
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest

import burrlab.fitting.region as region_grid
from burrlab import materials
from burrlab._core import Burr, Material
from burrlab.fitting.design import design
from burrlab.fitting.fit import fit
from burrlab.fitting.region import RegionGrid
from burrlab.measured.curve import VelocityCurve
from burrlab.measured.synthetic import synthetic_curve, synthetic_indentation
from burrlab.theory.continuum import MasterCurve

mpl.use("Agg")

NAN = float("nan")
BURR, BONE = Burr(3.0), materials["bone"]
ON_RIDGE = synthetic_curve(BURR, BONE, np.linspace(0.3, 0.6, 10), scatter=0.08, seed=1)  # 30 rows
ACROSS = synthetic_curve(BURR, BONE, [0.3, 0.6, 1.2, 2.4], scatter=0.08, repeats=6, seed=1)


@pytest.fixture(scope="module")
def ridge():
    return fit(ON_RIDGE)


@pytest.fixture(scope="module")
def across():
    return fit(ACROSS)


@pytest.fixture(scope="module")
def narrow():
    curve = synthetic_curve(BURR, BONE, [0.3, 0.6, 1.2, 2.4], scatter=0.01, repeats=40, seed=2)
    return fit([curve, synthetic_indentation(BURR, BONE, [0.2], scatter=0.01, repeats=80, seed=2)])


@pytest.fixture(scope="module")
def result(ridge):
    return design(ridge, [0.4, 1.0, 2.0, 4.0], [1.5, 3.0, 5.0], 3, static=[0.2])


def ratios(result):
    return {(one.force, one.depth, one.radius): one.area_ratio for one in result.rows}


class TestRanking:
    def test_off_the_ridge_first(self, ridge):
        assert ridge.status == "ridge"
        result = design(ridge, [0.3, 0.4, 0.5, 1.2, 2.0, 4.0], [1.5, 3.0], 3, static=[0.2])
        found = ratios(result)
        assert result.best.kind == "static"
        assert result.best.probability == 1
        assert found[None, 0.2, 3.0] < 0.2
        assert max(found[F, None, R] for F in (1.2, 2.0, 4.0) for R in (1.5, 3.0)) < 0.6
        assert found[0.5, None, 1.5] < 0.5 * found[0.5, None, 3.0]  # a smaller burr leaves the ridge too

    def test_more_of_the_same_is_worth_nearly_nothing(self, ridge):
        (again,) = design(ridge, 0.4, 3.0, 3).rows
        assert again.probability == 0
        assert again.c_e_ratio == np.inf
        # along a ridge the region is a band whose width goes with the root of the number of rows
        assert again.area_ratio == pytest.approx(np.sqrt(30 / 33), rel=0.02)

    def test_rows_are_sorted_and_complete(self, ridge):
        result = design(ridge, [0.4, 2.0], [1.5, 3.0, 5.0], 2, static=[0.1, 0.3], static_radius=5.0)
        assert len(result.rows) == 8
        values = [one.area_ratio for one in result.rows]
        assert values == sorted(values)
        assert [one.depth for one in result.rows if one.kind == "static"] == [0.1, 0.3]
        assert {one.radius for one in result.rows if one.kind == "static"} == {5.0}

    def test_more_repeats_shrink_further(self, across):
        areas = [design(across, 1.0, 3.0, n, static=0.2).rows for n in (2, 6, 24)]
        for kind in ("velocity", "static"):
            found = [one.area_ratio for rows in areas for one in rows if one.kind == kind]
            assert found[0] > found[1] > found[2]

    def test_static_depth_and_radius_do_not_matter(self, across):
        one = design(across, [], [], 3, static=[0.05, 0.9])
        other = design(across, [], [], 3, static=[0.2], static_radius=1.0)
        assert {row.area_ratio for row in one.rows} == {other.best.area_ratio}


class TestOracle:
    """Small scatter and a closed region: the areas go with the roots of the determinants of information."""

    @pytest.mark.parametrize("force", [0.4, 1.5, 3.0])
    def test_velocity(self, narrow, force):
        slope = -MasterCurve("parabolic").local_slope(force / (9 * narrow.c_e))
        J = np.array([slope, 1.0])
        self.check(narrow, design(narrow, force, 3.0, 32, scatter=0.01), 32 / 0.01**2 * np.outer(J, J))

    def test_static(self, narrow):
        share = np.diag([32 / 0.01**2, 0.0])
        self.check(narrow, design(narrow, [], [], 32, static=0.3, static_scatter=0.01), share)

    @staticmethod
    def check(narrow, result, share):
        old = narrow.evidence.information
        expected = np.sqrt(np.linalg.det(old) / np.linalg.det(old + share))
        assert expected < 0.95
        assert result.best.area_ratio == pytest.approx(expected, rel=0.02)

    @pytest.mark.parametrize("name", ["ridge", "across"])
    def test_a_finer_grid_says_the_same(self, name, request, monkeypatch):
        one = request.getfixturevalue(name)
        options = {"static": [0.2], "truths": 200}
        coarse = ratios(design(one, [0.4, 1.0, 4.0], 3.0, 5, **options))
        monkeypatch.setattr(region_grid, "_ROWS", 600)
        monkeypatch.setattr(region_grid, "_STEP", 0.02)
        fine = ratios(design(one, [0.4, 1.0, 4.0], 3.0, 5, **options))
        assert coarse == pytest.approx(fine, rel=0.03)

    @pytest.mark.parametrize("forces", [[0.3, 0.4, 0.5], [0.3, 0.6, 1.2, 2.4]])
    def test_area_is_that_of_the_region(self, forces):
        one = fit(synthetic_curve(BURR, BONE, forces, repeats=1, seed=1))
        assert np.exp(RegionGrid.of(one).log_area) == pytest.approx(area(one), rel=0.03)


def area(result, end=None):
    """Of the joint 95 % region in (log c_e, log alpha), up to c_e = end."""
    region = result.region()
    x = np.log(region.c_e)
    even = np.linspace(x[0], min(x[-1], np.log(result.bounds["c_e"][1] if end is None else end)), 3000)
    return np.trapezoid(np.interp(even, x, np.log(region.upper / region.lower)), even)


def simulated(before, result, candidate):
    """log(area ratio) and whether c_e was identified, of new data made at each truth and fitted."""
    grid = RegionGrid.of(before)
    old, made = area(before), []
    truths = zip(*grid.truths(result.truths, np.random.default_rng(result.seed)), strict=True)
    for k, (i, j) in enumerate(truths):
        c_e, alpha = np.exp([grid.log_c_e[i], grid.log_alpha[i, j]]).tolist()
        material, burr = Material("truth", c_e=c_e, alpha=alpha), Burr(candidate.radius)
        options = {"repeats": candidate.n, "seed": k}
        if candidate.kind == "velocity":
            new = synthetic_curve(burr, material, [candidate.force], scatter=result.scatter, **options)
        else:
            new = synthetic_indentation(
                burr, material, [candidate.depth], scatter=result.static_scatter, **options
            )
        again = fit([*before.data, new])
        made.append((np.log(area(again, result.c_e_end) / old), again.separately_identified))
    return np.array(made).T


class TestSimulation:
    """Real outcomes with scatter at the truths of the design, fitted again."""

    # At each truth the logarithm differs from the one foretold by its outcome's scatter, with a standard
    # deviation of 0.1 to 0.45, measured; 0.5 times 4.9 over the root of the number is false once in 1e6.
    @pytest.mark.parametrize(
        ("truths", "bias"), [(24, 0.10), pytest.param(200, 0.10, marks=pytest.mark.slow)]
    )
    def test_after_the_ridge(self, ridge, truths, bias):
        result = design(ridge, [0.4, 1.0, 2.0], 3.0, 3, static=[0.2], truths=truths)
        self.check(ridge, result, bias)

    @pytest.mark.slow
    @pytest.mark.parametrize("n", [2, 8])
    def test_after_a_closed_region(self, across, n):
        result = design(across, [0.4, 1.0, 2.0], 3.0, n, static=[0.2], truths=100)
        self.check(across, result, 0.10)

    @staticmethod
    def check(before, result, bias):
        found = []
        for one in result.rows:
            log_ratio, identified = simulated(before, result, one)
            found.append(np.exp(log_ratio.mean()))
            tolerance = bias + 4.9 * 0.5 / np.sqrt(result.truths)
            assert abs(log_ratio.mean() - np.log(one.area_ratio)) < tolerance
            if one.kind == "velocity":
                assert abs(identified.mean() - one.probability) < bias + 4.9 * 0.4 / np.sqrt(result.truths)
        # those that differ by more than the simulation can tell are in the right order
        foretold = np.array([one.area_ratio for one in result.rows])
        for i in range(len(found) - 1):
            clear = foretold > 1.15 * foretold[i]
            assert (np.array(found)[clear] > found[i]).all()


class TestOverloaded:
    def test_bounds_c_e_from_above(self, across):
        (one,) = design(across, 4.0, 3.0, 1).rows  # needs c_e > 2.31 N/mm^2, which bone has not
        assert one.overloaded > 0.8
        assert one.area_ratio < 1
        bounded = fit([ACROSS, synthetic_curve(BURR, BONE, 4.0, repeats=1, seed=1)])
        assert bounded.n_censored == 1
        truths = design(across, 4.0, 3.0, 1, truths=2000).best
        below = fit(ACROSS, bounds={"c_e": (0.1, 4.0 * 27**0.5 / 9)})  # the same bound, given
        assert area(bounded) == pytest.approx(area(below), rel=0.03)
        assert RegionGrid.of(across).below(4.0 * 27**0.5 / 9).log_area[0] == pytest.approx(
            np.log(area(bounded)), abs=0.03
        )
        assert truths.overloaded == pytest.approx(one.overloaded, abs=0.02)

    def test_without_a_window_for_any_truth_it_tells_nothing(self, ridge):
        (one,) = design(ridge, 100.0, 3.0, 3).rows
        assert one.overloaded == 1
        assert one.area_ratio == pytest.approx(1.0)
        assert one.probability == 0

    def test_a_window_excludes_low_c_e(self, ridge):
        grid = RegionGrid.of(ridge)
        truth = grid.truths(50, np.random.default_rng(0))
        assert (grid.minus2[truth] <= grid.farthest).all()
        assert np.ptp(grid.log_c_e[truth[0]]) > 3  # over the whole open region
        assert np.exp(grid.log_c_e[truth[0]]).max() <= ridge.bounds["c_e"][1]


class TestScatter:
    def test_is_the_fits_own(self, ridge, across):
        result = design(ridge, 1.0, 3.0, 2, static=[0.2])
        assert result.scatter == pytest.approx(ridge.evidence.scatters[0].value, rel=0.01)
        assert result.static_scatter == 0.1
        press = synthetic_indentation(BURR, BONE, [0.2], repeats=5, scatter=0.2, seed=1)
        both = fit([ACROSS, press])
        assert design(both, 1.0, 3.0, 1, static=[0.2]).static_scatter == pytest.approx(
            both.evidence.scatters[1].value, rel=0.01
        )

    def test_given(self, across):
        precise = design(across, 1.0, 3.0, 2, static=[0.2], scatter=0.02, static_scatter=0.02)
        rough = design(across, 1.0, 3.0, 2, static=[0.2], scatter=0.2, static_scatter=0.2)
        assert (precise.scatter, precise.static_scatter) == (0.02, 0.02)
        for key, value in ratios(precise).items():
            assert value < ratios(rough)[key]

    @pytest.mark.parametrize("residuals", ["absolute", "sigma"])
    def test_other_residuals_need_it(self, residuals):
        curve = VelocityCurve(
            ON_RIDGE.force, ON_RIDGE.velocity, sigma=0.08 * np.asarray(ON_RIDGE.velocity), radius=3.0
        )
        one = fit(curve, residuals=residuals)
        with pytest.raises(ValueError, match=f"scatter must be given, .* has '{residuals}' residuals"):
            design(one, 2.0, 3.0, 3)
        found = ratios(design(one, [0.4, 2.0], 3.0, 3, static=0.2, scatter=0.08))
        assert found[None, 0.2, 3.0] < found[2.0, None, 3.0] < 0.6 < found[0.4, None, 3.0]


class TestSeed:
    def test_same_seed_same_result(self, ridge):
        one, other = (design(ridge, [0.4, 2.0], 3.0, 3, seed=7) for _ in range(2))
        assert one == other

    def test_drawn_and_recorded(self, ridge):
        one = design(ridge, 2.0, 3.0, 3, seed=None)
        assert design(ridge, 2.0, 3.0, 3, seed=one.seed).rows == one.rows
        # truths are drawn systematically, so that a hundred do
        assert one.best.area_ratio == pytest.approx(
            design(ridge, 2.0, 3.0, 3, truths=2000).best.area_ratio, rel=0.05
        )


class TestResult:
    def test_repr(self, result):
        lines = repr(result).splitlines()
        assert lines[0] == (
            "Design: 13 candidates of 3 repeats; area of the joint 95 % region, now open, counted up to "
            "c_e = 34.64 N/mm^2, expected over 100 truths"
        )
        assert lines[1].split()[:4] == ["kind", "force", "[N]", "depth"]
        assert lines[2].split()[:3] == ["static", "0.2", "3"]
        assert lines[-1] == "and 5 more"

    def test_of_a_closed_region(self, across):
        result = design(across, 1.0, 3.0, 1)
        assert not result.open_above
        assert repr(result).startswith(
            "Design: 1 candidate of 1 repeat; area of the joint 95 % region, expected over"
        )

    def test_html(self, result):
        text = result._repr_html_()
        assert text.count("<tr>") == 14
        assert "<th>force [N]</th>" in text

    def test_to_dict_is_json(self, result):
        values = json.loads(json.dumps(result.to_dict(), allow_nan=False))
        assert values["rows"][0]["kind"] == "static"
        assert values["c_e_end"] == pytest.approx(34.64, abs=0.01)
        assert any(row["c_e_ratio"] is None for row in values["rows"])
        assert values["provenance"]["forces_N"] == [0.4, 1.0, 2.0, 4.0]

    def test_to_frame(self, result):
        pytest.importorskip("pandas")
        table = result.to_frame()
        assert list(table)[:5] == ["kind", "force_N", "depth_mm", "radius_mm", "n"]
        assert table.area_ratio.tolist() == [one.area_ratio for one in result.rows]

    def test_to_frame_without_pandas(self, result, monkeypatch):
        monkeypatch.setitem(sys.modules, "pandas", None)
        with pytest.raises(ImportError, match="to_frame needs pandas: pip install"):
            result.to_frame()

    def test_plot(self, result, across):
        ax = result.plot()
        assert ax.get_xlabel() == "force [N]"
        assert ax.get_ylabel() == "area of the 95 % region, new / old"
        labels = [text.get_text() for text in ax.get_legend().get_texts()]
        assert labels == [f"velocity, $R$ = {R} mm" for R in ("1.5", "3", "5")] + [
            "more likely overloaded",
            "static pairs",
        ]
        assert result.plot(ax) is ax
        only = design(across, [], [], 2, static=[0.2]).plot()
        assert [text.get_text() for text in only.get_legend().get_texts()] == ["static pairs"]


class TestBadInput:
    @pytest.mark.parametrize(
        ("arguments", "match"),
        [
            ({"forces": []}, "forces and radii, or static, must hold a candidate: got none"),
            ({"radii": [], "static": []}, "forces and radii, or static, must hold a candidate: got none"),
            ({"forces": [0.5, 0]}, "forces must be finite and above 0 N: got"),
            ({"forces": [NAN]}, "forces must be finite and above 0 N: got"),
            ({"forces": [[1.0]]}, "forces must be finite and above 0 N: got"),
            ({"radii": [-1.0]}, "radii must be finite and above 0 mm: got"),
            ({"n": 0}, "n must be at least 1: got 0"),
            (
                {"n": 1, "static": 0.2},
                "n must be at least 2 for the first static pairs, to show their scatter",
            ),
            ({"truths": 0}, "truths must be at least 1: got 0"),
            ({"static": [0.0]}, "static must be depths above 0 and below 2R = 6 mm: got"),
            ({"static": [0.1, 6.0]}, "static must be depths above 0 and below 2R = 6 mm: got"),
            ({"static": [NAN]}, "static must be depths above 0 and below 2R = 6 mm: got"),
            ({"static": 0.2, "static_radius": 0.0}, "static_radius must be finite and above 0 mm: got"),
            ({"scatter": 0.0}, "scatter must be finite and above 0: got 0.0"),
            ({"static": 0.2, "static_scatter": -1.0}, "static_scatter must be finite and above 0: got -1.0"),
        ],
    )
    def test_one_sentence(self, ridge, arguments, match):
        with pytest.raises(ValueError, match=match):
            design(ridge, **{"forces": [0.5], "radii": [3.0], "n": 3} | arguments)

    def test_not_a_fit(self):
        with pytest.raises(TypeError, match="fit must be a Fit, such as"):
            design(ON_RIDGE, 0.5, 3.0, 3)

    def test_fit_without_evidence(self, ridge):
        with pytest.raises(ValueError, match="this fit gave nothing to judge by"):
            design(replace(ridge, evidence=None), 0.5, 3.0, 3)

    def test_static_after_several_radii(self):
        small = synthetic_curve(Burr(1.5), BONE, [0.2, 0.4], seed=1)
        both = fit([ON_RIDGE, small])
        with pytest.raises(
            ValueError, match="static_radius must be given: the data of the fit are of several"
        ):
            design(both, [], [], 3, static=0.2)
        assert design(both, [], [], 3, static=0.2, static_radius=1.5).best.radius == 1.5
