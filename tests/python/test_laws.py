"""Which law data follow: what they tell of its exponents, which laws they contradict, and how often that is true."""

import json
import tracemalloc

import numpy as np
import pytest
from fit_scenes import BONE, BURR, curve_of, with_sigma
from session_scenes import refused

import burrlab
from burrlab import Indentation, Law, MasterCurve, VelocityCurve, compare_laws, fit
from burrlab.comparing.laws import LAWS, NODES, LawLikelihood, _tests, _weights, exponents, member
from burrlab.fitting.observations import Observations

DEPTHS = [0.05, 0.1, 0.2, 0.4]
TRUE = {name: LAWS[name] for name in ("paper", "preston-bone", "kobra", "quartic")}


def laboratory(law, seed=1, *, n=20, scatter=0.05, pressed=0):
    """Velocities at ten forces up to 0.85 of what leaves a window, and presses of the stopped burr."""
    random, material = np.random.default_rng([seed, n, pressed]), law.material(BONE.c_e, BONE.alpha)
    largest = 0.85 * material.c_e * 9 / 3**law.force_exponent
    F, h = np.tile(np.geomspace(0.25, min(largest, 2.8), 10), n // 10), np.tile(DEPTHS, pressed // 4)
    v = burrlab.penetration_velocity(BURR, material, F) * np.exp(scatter * random.normal(size=n))
    data = [VelocityCurve(F, v, radius=3.0)]
    force = material.c_e * 9 * (h / 3) ** law.force_exponent * np.exp(0.05 * random.normal(size=len(h)))
    return [*data, Indentation(force, h, 3.0)] if pressed else data


def proportional(largest, seed=1, scatter=0.05, n=20):
    """v = 0.5 F."""
    F = np.tile(np.geomspace(0.2, largest, 10), n // 10)
    v = 0.5 * F * np.exp(scatter * np.random.default_rng(seed).normal(size=n))
    return VelocityCurve(F, v, radius=3.0)


class TestLikelihood:
    @pytest.mark.parametrize("k", [0.125, 0.75, 2.25])
    def test_shapes_between_nodes(self, k):
        phi = np.log(np.geomspace(1e-3, 0.19, 60))
        nodes = np.array([MasterCurve(member(node)).log_velocity_ratio(phi) for node in NODES])
        between = _weights((k,))[0] @ nodes
        assert between == pytest.approx(MasterCurve(member(k)).log_velocity_ratio(phi), abs=2e-4)

    @pytest.mark.parametrize("law", TRUE.values(), ids=TRUE)
    def test_its_best_points_are_those_of_fits(self, law):
        points = {}
        for name, other in {"own": law, "other": Law("linear", 1.7, 0.5)}.items():
            fitted = fit(laboratory(law, pressed=12), law=other)
            best = LawLikelihood(fitted.observations).best(other)
            assert (best.c_e, best.alpha) == pytest.approx((fitted.c_e, fitted.alpha), rel=0.02)
            points[name] = best.aic - fitted.aic
        assert points["own"] == pytest.approx(points["other"], abs=0.1)

    @pytest.mark.parametrize("sigma", [False, True])
    def test_no_interval_where_no_law_fits(self, sigma):
        """A friction of 0.15 N bends ln v over ln F as no law does; s has no interval then."""
        F = np.repeat(np.geomspace(0.3, 2.2, 8), 3)
        noise = np.exp(0.03 * np.random.default_rng(1).standard_normal(24))
        for friction in (0.0, 0.15):
            v = Law().velocity(F - friction, BONE.c_e, BONE.alpha, 3.0) * noise
            curve = burrlab.VelocityCurve(F, v, radius=3.0, sigma=0.03 * v)
            found = compare_laws(curve, laws=["paper"], residuals="sigma" if sigma else "relative")
            assert (found.lack.p_value < 0.005) == (friction > 0) == found.sentences[0].startswith("No law")
            assert found.exponents["s"].intervals["95"].closed == (friction == 0)

    def test_runs_of_traces_count_by_their_mean(self):
        traces = [burrlab.synthetic_trace(BURR, BONE, F, seed=k) for k, F in enumerate([0.4, 0.7, 1.0, 1.3])]
        likelihood = LawLikelihood(Observations.of([*laboratory(Law()), *traces], None))
        assert likelihood.n == 24
        told = compare_laws([*laboratory(Law()), *traces], laws=["paper"], uncertain={"force": 0.01})
        assert told.exponents["s"].value == pytest.approx(8 / 3, abs=0.1)

    def test_rows_are_whitened_by_days_whatever_their_order(self):
        """Runs of curves stand before the means of traces, as in the fit whose effects whiten them."""
        (curve,) = laboratory(Law(), n=10)
        day = np.arange(10) // 4
        data = [VelocityCurve(curve.force, curve.velocity * 1.2**day, radius=3.0, groups={"day": day})]
        for k, F in enumerate([0.4, 0.9, 1.3]):
            trace = burrlab.synthetic_trace(BURR, BONE, F, seed=k)
            data.append(burrlab.DepthTrace(trace.time, trace.immersion, F, 3.0, groups={"day": k % 2}))
        fitted = fit(data)
        o, equations = fitted.observations, fitted.likelihood.equations
        of_run = np.equal.outer([*range(3, 13), 0, 1, 2], o.run_number)
        whitened = LawLikelihood(o, effects=fitted.likelihood).whitened(of_run)
        labels = np.append(day, [0, 1, 0])
        variance = np.eye(13) + equations.effect2[0] / equations.scatter2[0] * np.equal.outer(labels, labels)
        assert equations.effect2[0] > 0
        assert whitened @ whitened.T == pytest.approx(np.linalg.inv(variance), abs=1e-9)

    def test_memory_of_many_rows(self):
        """5000 rows take no table of rows by rows, 200 MB."""
        (curve,) = laboratory(Law(), n=5000)
        o = Observations.of([curve], None)
        tracemalloc.start()
        LawLikelihood(o).best(None)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 2e7

    def test_days_do_not_move_the_slope(self):
        """Each force on a day of its own half: without the days' effects s would follow them."""
        (curve,) = laboratory(Law(), n=40)
        day = np.repeat([0, 1, 0, 1], 10)
        v = curve.velocity * np.exp(0.5 * day)
        compared, blind = (
            compare_laws(VelocityCurve(curve.force, v, radius=3.0, groups=groups), laws=["paper"])
            for groups in ({"day": day}, None)
        )
        ends = [x.exponents["s"].intervals["95"] for x in (compared, blind)]
        assert 8 / 3 in ends[0]
        assert ends[0].upper - ends[0].lower < 0.3 * (ends[1].upper - ends[1].lower)
        told = ["Differences between the 2 days" in " ".join(x.sentences) for x in (compared, blind)]
        assert (compared.contradicted, told) == ((), [True, False])


class TestAnswers:
    def test_a_tare_that_is_told_contradicts_no_law(self):
        curve, presses = laboratory(Law(), pressed=12)
        both = [curve, Indentation(presses.force + 0.05, presses.depth, 3.0)]
        tared = [VelocityCurve(x.force - 0.05, x.velocity, radius=3.0) for x in (curve, proportional(1.5))]
        for name, data, true in (
            ("paper", tared[0], {"s": Law().slope}),
            ("paper", both, {"q": 1.5, "m": 0.0, "k": 1.0}),
            ("preston", tared[1], {"s": 1.0}),
        ):
            silent, told = (compare_laws(data, laws=[name], uncertain=x) for x in (None, {"force": 0.04}))
            assert [bool(x[name].contradicted) for x in (silent, told)] == [True, False]
            held = [[v in x.exponents[k].intervals["95"] for k, v in true.items()] for x in (silent, told)]
            assert held == [[False] * len(true), [True] * len(true)]
        wrong = fit(laboratory(Law()), law="quartic", uncertain={"force": 0.03})
        assert wrong.status in (
            "implausible",
            "poor-fit",
        )  # its best offset moves the bound of c_e past the walk's best

    @pytest.mark.parametrize("name", TRUE)
    def test_the_law_of_the_data_is_left(self, name):
        law = TRUE[name]
        compared = compare_laws(laboratory(law, n=30, pressed=16))
        assert (
            name in {row.name for row in compared.close} <= {name, *(["linear"] if name == "paper" else [])}
        )
        for exponent, value in (("s", law.slope), ("q", law.force_exponent), ("m", law.rate_exponent), ("k", law.shape.order)):  # fmt: skip
            assert value in compared.exponents[exponent].intervals["99.7"]
        assert compared.exponents["q"].value == pytest.approx(law.force_exponent, abs=0.07)
        row = compared[name]
        assert row.fit.law == law
        assert row.constants.startswith("c_e = ")
        assert all(
            other.constants == "" and other.fit is None for other in compared.rows if other.contradicted
        )

    @pytest.mark.parametrize(
        "largest", [0.95, *(pytest.param(x, marks=pytest.mark.slow) for x in (1.5, 2.4, 4.8))]
    )
    def test_proportional(self, largest):
        """Of Preston's law, which the paper's fit calls implausible, s is within 0.08 of 1."""
        curve = proportional(largest)
        assert "compare_laws" in fit(curve).verdict
        compared = compare_laws(curve)
        assert compared.exponents["s"].value == pytest.approx(1.0, abs=0.08)
        # up to 0.95 and 1.5 N the likeliest law of these has s = 1.08 and 1.10
        likelihood = LawLikelihood(Observations.of([proportional(largest, 4)], None))
        assert exponents(likelihood, Law())[0]["s"].value == pytest.approx(1.0, abs=0.08)
        assert compared.best.name == "preston"
        assert {"paper", "linear", "quartic", "kobra"} <= {*compared.contradicted}
        assert "K = 0.5" in compared["preston"].constants

    def test_what_is_said(self):
        report = compare_laws(laboratory(Law(), n=20)).report()
        for text in (
            "Velocities determine s = 2 (k + 1)/q + m, with v ~ F^s at small forces: 2.6", "would tell q.",
            "The data contradict kobra. Another m fits better: F(1, 17) = ", "are not told apart: their AIC lies within 4",
        ):  # fmt: skip
            assert text in report
        small = compare_laws(curve_of([0.2, 0.25, 0.3, 0.4], seed=1, scatter=0.05, repeats=3), laws=["paper"])
        assert small["paper"].constants.startswith(
            "c_e above 0.46; alpha/c_e^2.667 = "
        )  # the window's bound is 0.23
        assert "several radii" not in report
        refused((lambda: small["kobra"], "this comparison holds paper: got 'kobra'", KeyError))

    def test_where_laws_part(self):
        compared = compare_laws(laboratory(Law(), 2, pressed=16), laws=["paper", "linear"])
        (parting,) = compared.partings
        start = f"{parting.name.capitalize()} parts most from {compared.best.name} at "
        assert (parting.runs > 1, compared.sentences[-1][: len(start)]) == (True, start)
        assert all(sentence[0].isupper() for sentence in compared.sentences)

    def test_files_and_figures(self):
        compared = compare_laws(laboratory(Law("parabolic", 2, 1), pressed=12))
        plain = json.loads(json.dumps(compared.to_dict(), allow_nan=False))
        assert plain["rows"][0]["law"] == "kobra"
        assert (
            plain["exponents"]["q"]["intervals"]["95"][0] < 2 < plain["exponents"]["q"]["intervals"]["95"][1]
        )
        assert len(compared.to_dataframe()) == len(LAWS)
        left, right = compared.plot()
        assert left.get_legend_handles_labels()[1][1:] == [
            "kobra",
            f"contradicted: {', '.join(compared.contradicted)}",
        ]
        assert right.get_title().startswith("mean s = 3")
        assert compared.plot_exponent("q").get_xlabel() == "$q$ of $F \\sim h^q$"

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"laws": []}, "one law or more"), ({"laws": ["paper", Law()]}, "'parabolic' twice"),
            ({"laws": ["papr"]}, "got 'papr'; did you mean 'paper'"), ({"level": 1.0}, "level must be between 0 and 1"),
            ({"residuals": "absolute"}, "residuals must be 'relative' or 'sigma'"), ({"residuals": "sigma"}, "sigma"),
            ({"uncertain": {"force": (0.04, "data set")}}, "of a group goes with velocities alone"),
        ],
    )  # fmt: skip
    def test_what_is_refused(self, options, message):
        refused((lambda: compare_laws(laboratory(Law(), pressed=4), **options), message))

    def test_a_linear_f_with_several_radii(self):
        """q of a linear f is sought as closely as that of the family, and the sentences name other f's."""
        law, data = Law("linear", 1.94), []
        for R in (2.0, 4.0):
            F = np.geomspace(0.1, 1.0, 10) * 2.8 * (R / 3) ** 2
            v = burrlab.penetration_velocity(burrlab.Burr(R), law.material(BONE.c_e, BONE.alpha), F)
            data.append(VelocityCurve(F, v, radius=R))
        compared = compare_laws(data, laws=["paper"])
        assert compared.exponents["s"].value == pytest.approx(law.slope, abs=2e-3)
        assert "With several radii the shape of f counts" in compared.report()


class TestOddData:
    """What a second pair of eyes broke."""

    def test_presses_beside_proportional_velocities(self):
        """v = K F says nothing of the bone: presses with q = 2 do not count against it."""
        random, h = np.random.default_rng(8), np.resize(DEPTHS, 12)
        presses = Indentation(30 * 9 * (h / 3) ** 2 * np.exp(0.05 * random.normal(size=12)), h, 3.0)
        compared = compare_laws([proportional(2.4), presses])
        assert "preston" in {row.name for row in compared.close}
        assert "contradict every law" not in compared.report()

    @pytest.mark.parametrize("bent", ["bend", "radii", "saturation"])
    def test_preston_is_tested(self, bent):
        F, noise = np.repeat(np.geomspace(0.3, 2.4, 8), 3), np.random.default_rng(1).normal(size=24)
        x = np.log(F / F.min()) / np.log(8) - 0.5
        v = {"bend": 0.5 * F * np.exp(1.2 * x**2), "saturation": 0.5 * np.minimum(F, 1) ** 2}.get(
            bent, 0.5 * F
        )
        data = VelocityCurve(F, v * np.exp(0.03 * noise), radius=3.0)
        if bent == "radii":
            ends = ((1.5, 0.1, 0.6), (4.0, 0.8, 4.5))
            data = [
                burrlab.synthetic_curve(burrlab.Burr(R), BONE, np.geomspace(*at, 6), scatter=0.03, seed=1)
                for R, *at in ends
            ]
        assert compare_laws(data, laws=["preston"]).contradicted == ("preston",)

    def test_sigma_counts_with_days_and_is_blamed(self):
        (curve,) = laboratory(Law(), n=20)
        known = with_sigma(curve, 0.05)
        days = VelocityCurve(
            curve.force, curve.velocity, sigma=known.sigma, radius=3.0, groups={"day": np.arange(20) % 3}
        )
        found = [compare_laws(x, laws=["paper"], residuals="sigma").exponents["s"] for x in (known, days)]
        assert found[0].limits["95"] == pytest.approx(3.841, abs=1e-3)
        widths = [exponent.intervals["95"].ratio() for exponent in found]
        assert widths[1] == pytest.approx(widths[0], rel=0.1)
        blamed = compare_laws(with_sigma(curve, 0.02), laws=["paper"], residuals="sigma")
        assert "sigma" in blamed["paper"].why

    def test_bounds_that_cross(self):
        """An overloaded run beside traces, whose windows end elsewhere, leaves some q no c_e."""
        traces = [burrlab.synthetic_trace(BURR, BONE, F, seed=k) for k, F in enumerate([0.4, 0.7, 1.0])]
        over = VelocityCurve(
            [0.5, 0.8, 1.2, 3.9],
            [0.08, 0.28, 0.8, np.nan],
            radius=3.0,
            status=["ok", "ok", "ok", "overloaded"],
        )
        assert "paper" not in compare_laws([over, *traces]).contradicted

    def test_labels_of_one_run_each_and_sets_of_few(self):
        (curve,) = laboratory(Law())
        labelled = VelocityCurve(curve.force, curve.velocity, radius=3.0, groups={"day": np.arange(20)})
        rows = [VelocityCurve(curve.force[k::5], curve.velocity[k::5], radius=3.0) for k in range(5)]
        # sets whose offsets are given cost no degrees of freedom either
        s = [
            compare_laws(data, laws=["paper"], uncertain=offset).exponents["s"].intervals["95"]
            for data, offset in ((curve, None), (labelled, None), (rows, {"force": 1e-6}))
        ]
        ends = [(x.lower, x.upper) for x in s]
        assert ends[1:] == [pytest.approx(ends[0], abs=1e-6)] * 2

    def test_presses_that_need_another_c_e_give_no_q(self):
        material = Law().material(c_e=2.1, alpha=0.09)
        forces, depths = np.geomspace(0.36, 3.1, 8), [0.05, 0.1, 0.2, 0.4]
        curve = burrlab.synthetic_curve(BURR, material, forces, repeats=2, scatter=0.05, seed=0)
        presses = burrlab.synthetic_indentation(BURR, material, depths, repeats=3, scatter=0.05, seed=50)
        compared = compare_laws([curve, Indentation(0.6 * presses.force, presses.depth, 3.0)], laws=["paper"])
        assert "indentation alone tells q = 1.51, with the velocities it would be 1.69" in compared.report()
        assert [x.interval_text == "no interval" for x in compared.exponents.values()] == [
            False,
            True,
            True,
            True,
        ]

    def test_presses_of_another_scale_contradict_a_law_that_velocities_do_not(self):
        material = Law().material(c_e=2.1, alpha=0.09)
        curve = burrlab.synthetic_curve(
            BURR, material, np.geomspace(0.25, 2.2, 10), repeats=2, scatter=0.05, seed=0
        )
        presses = burrlab.synthetic_indentation(
            BURR, material, [0.05, 0.1, 0.2, 0.4], repeats=4, scatter=0.05, seed=1000
        )
        soft = [Indentation(by * presses.force, presses.depth, 3.0) for by in (0.8, 0.88)]
        compared, harder = (compare_laws([curve, x], laws=["paper", "linear"]) for x in soft)
        assert (
            "The velocities alone do not: beside them the indentation's forces are 0.79 times"
            in compared["paper"].why
        )
        for name in ("m", "k"):  # of one f
            assert compared.exponents[name].if_harder == pytest.approx(harder.exponents[name].value, abs=0.01)

    def test_a_friction_without_repeats_is_named(self):
        force = np.geomspace(0.3, 2.2, 20)
        velocity = burrlab.penetration_velocity(BURR, Law().material(c_e=2.1, alpha=0.09), force - 0.1)
        curve = VelocityCurve(
            force, velocity * np.exp(0.05 * np.random.default_rng(1).normal(size=20)), radius=3.0
        )
        compared = compare_laws(curve)
        assert (
            "a friction, these fit as well as kobra or better: paper by -0.098 N (AIC -" in compared.report()
        )
        table = compared.to_dataframe().set_index("law")
        assert table["force_offset_N"]["paper"] == pytest.approx(-0.1, abs=0.02)
        assert table["delta_aic_with_offset"]["paper"] < -20
        told = compare_laws(curve, uncertain={"force": 0.1})
        assert (told["paper"].with_offset, told["paper"].contradicted) == (None, False)
        pressed = burrlab.synthetic_indentation(
            burrlab.Burr(3.0), burrlab.materials["bone"], DEPTHS, repeats=4, scatter=0.05, seed=1
        )
        assert compare_laws([curve, pressed])["kobra"].with_offset is None  # as these contradict it

    def test_presses_of_a_small_q(self):
        for q in (0.9, 1.0):
            h = np.repeat(DEPTHS, 4)
            force = 5 * h**q * np.exp(0.05 * np.random.default_rng(2).normal(size=16))
            compared = compare_laws([*laboratory(Law()), Indentation(force, h, 3.0)])
            assert q in compared.exponents["q"].intervals["95"]
            assert ("No law here has q below 1" in compared.report()) == (q < 1)
            assert compared.exponents["q"].intervals["99.7"].closed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n", "scatter", "pressed"), [(10, 0.05, 0), (30, 0.08, 0), (20, 0.05, 12), (20, 0.08, 24)]
)
@pytest.mark.parametrize("name", TRUE)
def test_how_often_it_is_true(name, n, scatter, pressed):
    law, sets = TRUE[name], 1000
    true = {"s": law.slope, "q": law.force_exponent, "m": law.rate_exponent, "k": law.shape.order}
    held, rejected, misled = dict.fromkeys(true, 0), 0, 0
    for seed in range(sets):
        data = laboratory(law, seed, n=n, scatter=scatter, pressed=pressed)
        likelihood = LawLikelihood(Observations.of(data, None))
        for exponent, found in exponents(likelihood, law)[0].items():
            held[exponent] += true[exponent] in found.intervals["95"]
        aic = {other: likelihood.best(each).aic for other, each in LAWS.items()}
        tests = _tests(likelihood, law, likelihood.best(law).height)
        rejected += min(test.p_value for test in tests) * len(tests) < 0.05
        alike = {name, "linear"} if name == "paper" else {name}
        misled += min(aic[other] for other in aic.keys() - alike) < aic[name] - 4
    print(name, n, scatter, pressed, {x: f"{100 * k / sets:.1f} %" for x, k in held.items() if k},
          f"rejected {100 * rejected / sets:.1f} %, another preferred by 4 in {100 * misled / sets:.1f} %")  # fmt: skip
    assert rejected <= 0.07 * sets
    assert min(k for x, k in held.items() if x == "s" or pressed) >= 0.93 * sets, held
