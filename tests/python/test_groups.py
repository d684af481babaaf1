"""Days and specimens in a fit: variances, degrees of freedom, what is said, and how often it is true."""

import io
import json

import numpy as np
import pytest

import burrlab
from burrlab import Indentation, VelocityCurve
from burrlab.cli import main
from burrlab.fitting.comparison import ERROR
from burrlab.fitting.groups import _LinearModel, components_of
from burrlab.fitting.profile import C_E

BURR, BONE = burrlab.Burr(3.0), burrlab.materials["bone"]
FORCES = np.geomspace(0.3, 2.2, 8)


def laboratory(seed, n, *, design="crossed", between=0.1, of_c_e=0.0, within=0.05, group="day"):
    """A curve of `n` days or specimens: all forces on each, or (blocks) a part of the forces on each."""
    random = np.random.default_rng(seed)
    level = np.repeat(np.arange(n), 8)
    force = np.tile(FORCES, n)
    if design == "blocks":
        force = np.repeat(np.geomspace(0.3, 2.2, 12), 3)
        level = np.repeat(np.arange(n), len(force) // n)
    c_e, alpha = (
        BONE.c_e * np.exp(of_c_e * random.normal(size=n)),
        BONE.alpha * np.exp(between * random.normal(size=n)),
    )
    materials = [burrlab.Material("level", c_e=c, alpha=a) for c, a in zip(c_e, alpha, strict=True)]
    v = np.array(
        [burrlab.penetration_velocity(BURR, materials[k], F) for k, F in zip(level, force, strict=True)]
    )
    v *= np.exp(within * random.normal(size=len(v)))
    ok = np.isfinite(v)
    labels = [f"{group} {k}" for k in level[ok]]
    return VelocityCurve(force[ok], v[ok], radius=3.0, groups={group: labels}, source="synthetic")


class TestVariances:
    @pytest.mark.parametrize(
        ("curve", "n"), [(laboratory(1, 4), 1), (laboratory(2, 3, design="blocks"), 1), (laboratory(3, 6, of_c_e=0.1, group="specimen"), 2)],
        ids=["days", "blocks", "specimens"],
    )  # fmt: skip
    @pytest.mark.filterwarnings("ignore:The MLE may be on the boundary")  # of a parameter that it has besides
    def test_of_the_linear_model_are_those_of_statsmodels(self, curve, n):
        """REML, and the standard errors at its variances; its step is 0 at the fit."""
        mixed = pytest.importorskip("statsmodels.regression.mixed_linear_model")
        fit = burrlab.fit(curve)
        equations, components = fit.likelihood.equations, components_of(fit.observations)
        assert len(components) == n
        model = _LinearModel(fit.likelihood, components, (fit.c_e, fit.alpha))
        J, r = model.rows[0].J, model.rows[0].r
        names = [str(i) for i in range(n)]
        columns = [[model.columns[0][:, block]] for block in model.blocks]
        effects = mixed.VCSpec(names, [[[""] * c[0].shape[1]] for c in columns], columns)
        theirs = mixed.MixedLM(r, J, np.ones(len(r)), exog_vc=effects, exog_re=None).fit(
            reml=True, method=["lbfgs", "powell"]
        )
        assert theirs.scale == pytest.approx(equations.scatter2[0], rel=2e-3)
        assert theirs.vcomp == pytest.approx(equations.effect2, rel=5e-3, abs=1e-5)
        assert theirs.bse_fe == pytest.approx(np.sqrt(np.diag(equations.uncertainty().covariance)), rel=3e-3)
        assert np.abs(theirs.fe_params).max() < 1e-3

    def test_of_balanced_days_are_those_of_the_analysis_of_variance(self):
        fit = burrlab.fit(laboratory(1, 4))
        evidence = fit.evidence.groups
        r = fit.residuals.reshape(4, 8)
        between = 8 * np.sum((r.mean(axis=1) - r.mean()) ** 2) / 3
        within = (np.sum(r**2) - 8 * np.sum(r.mean(axis=1) ** 2)) / (32 - 4 - 1)
        assert evidence.scatter2[0] == pytest.approx(within, rel=1e-5)
        assert evidence.effects[0].deviation == pytest.approx(np.sqrt((between - within) / 8), rel=1e-4)

    def test_effects_of_days_are_found(self):
        curve = laboratory(1, 12, within=0.01)
        (effect,) = burrlab.fit(curve).evidence.groups.effects
        random = np.random.default_rng(1)
        random.normal(size=12)
        true = 0.1 * random.normal(size=12)
        assert np.array(effect.values) - np.mean(effect.values) == pytest.approx(true - true.mean(), abs=0.02)
        assert effect.levels[:2] == ("day 0", "day 1")
        assert effect.interval.lower < 0.1 < effect.interval.upper

    def test_pressed_rows_tell_c_e_of_their_specimens(self):
        """Four specimens of c_e 15 % apart; the days do not move a burr that stands still."""
        c_e = BONE.c_e * np.exp([-0.2, -0.05, 0.1, 0.15])
        depth = np.tile([0.1, 0.2, 0.3], 4)
        force = (
            np.repeat(c_e, 3)
            * np.sqrt(3.0)
            * depth**1.5
            * np.exp(0.01 * np.random.default_rng(1).normal(size=12))
        )
        pressed = Indentation(force, depth, 3.0, specimen=np.repeat(list("ABCD"), 3))
        curve = burrlab.synthetic_curve(BURR, BONE, FORCES, repeats=2, scatter=0.05, seed=1)
        curve = VelocityCurve(curve.force, curve.velocity, radius=3.0, specimen=["A", "B"] * 8)
        effects = {x.quantity: x for x in burrlab.fit([curve, pressed]).evidence.groups.effects}
        assert np.array(effects["c_e"].values) == pytest.approx([-0.2, -0.05, 0.1, 0.15], abs=0.03)


class TestFreedom:
    def test_of_crossed_days(self):
        """The level of alpha has one degree less than the days, c_e those of all rows."""
        calibration = burrlab.fit(laboratory(1, 4)).evidence.groups.calibration
        level = np.array([-calibration.covariance[0, 1] / calibration.covariance[0, 0], 1.0])
        assert calibration.freedom(level) == pytest.approx(3, rel=1e-4)
        assert calibration.freedom(C_E) == pytest.approx(32 - 4 - 1, rel=1e-4)
        assert calibration.adjusted == pytest.approx(calibration.covariance, rel=1e-6)

    def test_limits_and_probabilities_are_inverse(self):
        calibration = burrlab.fit(laboratory(2, 3, design="blocks")).evidence.groups.calibration
        for direction in (None, C_E, np.array([-2.5, 1.0])):
            limits = calibration.limits({"68": 0.68, "95": 0.95}, direction)
            for level, p in (("68", 0.32), ("95", 0.05)):
                assert calibration.probability(limits[level], direction) == pytest.approx(p)
            if direction is not None:
                assert calibration.threshold(direction).limit(0.95) == pytest.approx(limits["95"])


class TestWhatIsSaid:
    def test_verdicts(self):
        curve = burrlab.synthetic_curve(BURR, BONE, [0.3, 0.6, 1.2, 2.4], seed=1)

        def verdict(**labels):
            return burrlab.fit(VelocityCurve(curve.force, curve.velocity, radius=3.0, **labels)).verdict

        assert "All runs are of one day: nothing here tells the day from the bone." in verdict(
            groups={"day": "Monday"}
        )
        assert "Each run has a day of its own: nothing tells" in verdict(groups={"day": range(12)})
        assert "cannot be known from fewer than three" in verdict(specimen=["A", "B"] * 6)
        text = burrlab.fit(laboratory(1, 4)).verdict
        assert "Between the 4 days alpha differs by 7.3 % (3.9 to 28 %)." in text
        assert text.endswith(
            "The interval of alpha rests on 30 degrees of freedom, that of alpha/c_e^2.57 on 3."
        )

    def test_intervals_widen_and_labels_can_be_left_out(self, tmp_path):
        curve = laboratory(1, 4)
        fit, without = burrlab.fit(curve), burrlab.fit(curve, groups=())
        assert fit.identified.interval.ratio() > 2 * without.identified.interval.ratio() - 1
        unlabelled = burrlab.fit(VelocityCurve(curve.force, curve.velocity, radius=3.0))
        assert (without.intervals, without.identified) == (unlabelled.intervals, unlabelled.identified)
        assert without.evidence.groups is None
        fit.to_json(tmp_path / "fit.json")
        again = burrlab.Fit.from_json(tmp_path / "fit.json")
        assert (again.verdict, again.intervals) == (fit.verdict, fit.intervals)
        assert again.test(2.0, 0.08).p_value == fit.test(2.0, 0.08).p_value
        assert again.influence()[0].c_e == pytest.approx(fit.influence()[0].c_e)

    def test_one_day_a_set_allows_no_decision(self):
        first, second = (laboratory(seed, 1, between=0.0) for seed in (1, 2))
        second = VelocityCurve(second.force, 2 * second.velocity, radius=3.0, groups={"day": "day 9"})
        (pair,) = burrlab.compare(burrlab.fit(first), burrlab.fit(second)).pairs
        assert (pair.p_differ < ERROR, pair.differ, pair.equivalent) == (True, False, False)
        assert "no test can tell the sets from the days" in pair.obstacle


def curve(**labels):
    return VelocityCurve([1.0, 2.0, 3.0], [0.1, 0.4, 0.9], radius=3.0, **labels)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: curve(groups={"day": ["a", "b"]}), ValueError, "day must have 3 labels, one a row: got 2"),
        (lambda: curve(groups=3), TypeError, "groups must be a mapping"),
        (lambda: curve(groups={"a,b": "x"}), ValueError, "name of a group must be of letters"),
        (lambda: curve(specimen=["a", None, "b"]), ValueError, "row 1, specimen: every row needs a label"),
        (lambda: burrlab.fit(curve(specimen="a"), groups=["day"]), ValueError, "groups may be of specimen: got 'day'"),
        (lambda: burrlab.fit([curve(specimen="a"), curve()]), ValueError, "data set 2 has no specimen, which others have"),
        (lambda: burrlab.fit(curve(specimen=[1, 2, 2], groups={"day": [3, 4, 4]})), ValueError,
         "specimen and day cannot be told apart: each specimen has one day"),
        (lambda: burrlab.fit(laboratory(1, 3)).bootstrap(5, seed=1), ValueError, "a bootstrap draws runs, not groups"),
        (lambda: burrlab.design(burrlab.fit(laboratory(1, 3)), [1.0], [3.0], 1), ValueError, "a design needs a fit without groups"),
        (lambda: burrlab.fit(laboratory(1, 3), residuals="student"), ValueError, "residuals must be 'relative' with groups"),
    ],
)  # fmt: skip
def test_what_is_refused(call, error, text):
    with pytest.raises(error, match=text):
        call()


class TestFiles:
    def test_labels_come_back(self):
        labelled, file = (
            curve(groups={"day": [1.0, 1, 2]}, specimen=["A, left", "A, left", "B"]),
            io.StringIO(),
        )
        labelled.to_csv(file)
        file.seek(0)
        assert VelocityCurve.from_csv(file) == labelled
        trace = burrlab.synthetic_trace(BURR, BONE, 1.0, seed=1)
        trace = burrlab.DepthTrace(
            trace.time, trace.immersion, 1.0, 3.0, groups={"day": "3 May"}, specimen="Ä"
        )
        file = io.StringIO()
        trace.to_csv(file)
        file.seek(0)
        assert burrlab.DepthTrace.from_csv(file) == trace
        with pytest.raises(ValueError, match="groups in the comments must be JSON"):
            burrlab.DepthTrace.from_csv(io.StringIO(file.getvalue().replace("{", "")))

    def test_of_a_laboratory(self, tmp_path, capsys):
        text = "Kraft;v;Messtag;Probe\n1;0,1;Mo;a\n2;0,4;Di;b\n3;0,9;Di;\n"
        columns = {"force": "Kraft", "velocity": "v"}
        read = VelocityCurve.from_csv(
            io.StringIO(text), columns=columns, decimal=",", groups={"day": "Messtag"}
        )
        assert read.groups == {"day": ("Mo", "Di", "Di")}
        assert read.others == {"Probe": ("a", "b", "")}
        for specimen, message in (
            ("Probe", "row 2, specimen: every row needs a label"),
            ("Bone", "no column is Bone; there are Messtag, Pr"),
        ):
            with pytest.raises(ValueError, match=message):
                VelocityCurve.from_csv(io.StringIO(text), columns=columns, decimal=",", specimen=specimen)
        frame = {"F": [1.0, 2.0], "v": [0.1, 0.4], "who": ["AB", "CD"]}
        assert VelocityCurve.from_dataframe(
            frame, force="F", velocity="v", groups={"operator": "who"}
        ).groups == {"operator": ("AB", "CD")}

        laboratory(1, 4).to_csv(tmp_path / "lab.csv")
        command = ["fit", str(tmp_path / "lab.csv"), "--json", str(tmp_path / "fit.json")]
        for options, said in ([], "Between the 4 days"), (["--groups", "none"], ""):
            assert main(command + options) == 0
            assert said in capsys.readouterr().out
            groups = json.loads((tmp_path / "fit.json").read_text())["evidence"]["groups"]
            assert bool(groups) == bool(said)


# A share of 400 lies within four standard errors of its probability but once in 16 000.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("design", "n", "between", "of_c_e"),
    [
        ("crossed", 2, 0.1, 0.0), ("crossed", 3, 0.1, 0.0), ("crossed", 6, 0.1, 0.0), ("crossed", 6, 0.05, 0.0),
        ("crossed", 3, 0.0, 0.0), ("blocks", 3, 0.1, 0.0), ("blocks", 6, 0.1, 0.0), ("specimen", 3, 0.1, 0.1), ("specimen", 6, 0.1, 0.1),
    ],
)  # fmt: skip
def test_intervals_hold_the_truth(design, n, between, of_c_e):
    sets, held = 400, dict.fromkeys(("c_e", "alpha", "combination", "region", "deviation"), 0)
    for seed in range(sets):
        group = "specimen" if of_c_e else "day"
        fit = burrlab.fit(
            laboratory(seed, n, design=design, between=between, of_c_e=of_c_e, group=group), plausible=None
        )
        held["c_e"] += BONE.c_e in fit.intervals["c_e"]["95"]
        held["alpha"] += BONE.alpha in fit.intervals["alpha"]["95"]
        held["combination"] += BONE.alpha / BONE.c_e**fit.identified.exponent in fit.identified.interval
        held["region"] += fit.test(BONE.c_e, BONE.alpha).p_value > 0.05
        held["deviation"] += between in fit.evidence.groups.effects[-1].interval
    print(design, n, between, {name: f"{100 * k / sets:.1f} %" for name, k in held.items()})
    error = np.sqrt(0.05 * 0.95 * sets)
    assert min(held.values()) > 0.95 * sets - 4 * error, held


@pytest.mark.slow
@pytest.mark.parametrize(
    ("design", "n", "of_c_e"), [("crossed", 3, 0.0), ("blocks", 3, 0.0), ("specimen", 3, 0.1)]
)
def test_sets_of_one_bone_seldom_differ(design, n, of_c_e):
    sets, group = 200, "specimen" if of_c_e else "day"
    differ = sum(
        burrlab.compare(
            *(burrlab.fit(laboratory(2 * seed + k, n, design=design, of_c_e=of_c_e, group=group), plausible=None) for k in (0, 1))
        ).pairs[0].differ
        for seed in range(sets)
    )  # fmt: skip
    print(design, n, f"false 'differ' {100 * differ / sets:.1f} %")
    assert differ < sets * ERROR + 4 * np.sqrt(sets * ERROR)
