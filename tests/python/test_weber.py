"""Weber fractions along references: the group's slope, what it is worth, and its way from trials."""

import itertools
import math
from collections import Counter
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from answer_scenes import SMALL, give, protocol, run
from scipy.special import ndtr
from scipy.stats import binom, linregress, norm, t, ttest_1samp
from session_scenes import refused

import burrlab
from burrlab.psychophysics import (
    AdaptiveStaircase,
    PsychometricSeat,
    SensitivityFunction,
    Sitting,
    Staircase,
    Stimulus,
    WeberFraction,
    analyse,
    psychometric_function,
    subjects_for_slope,
)
from burrlab.psychophysics.analysis import Analysis, group_lines
from burrlab.psychophysics.psychometric import proportion_correct
from burrlab.psychophysics.task_results import SubjectThreshold, ThresholdTask

REFERENCES = np.geomspace(0.5, 8.0, 5)


def group(random, slope=-0.4, between=0.2, subjects=8, error=0.2, references=REFERENCES):
    """Fractions whose slopes differ between subjects; errors differ between fractions and are known."""
    rows = []
    for i in range(subjects):
        own, level = slope + between * random.normal(), math.log(0.2) + 0.3 * random.normal()
        for p0 in references:
            known = error * np.exp(0.2 * random.normal())
            ln_w = level + own * math.log(p0 / 2.0) + known * random.normal()
            rows.append(WeberFraction(str(i), p0, math.exp(ln_w), known))
    return rows


@pytest.mark.parametrize(
    ("seed", "between", "lmer", "with_sessions"),
    [
        (3, 0.4, (-0.3877456, 0.2350458, 6.9941, 0.1430357, 0.6566668), (-0.45302368, 0.24224201)),
        (4, 0.2, (-0.3211677, 0.0960271, 7.0720, 0.0121580, 0.2569328), (-0.36887706, 0.10799310)),
    ],
)
def test_beside_lmer(seed, between, lmer, with_sessions):
    """lmerTest 3.1-3: lmer(log(W) ~ log(p0/2) + (log(p0/2) | subject), weights = 1/se^2), Satterthwaite.

    Then with `+ session`, where the session changes with the reference: the slopes' errors are shared.
    """
    rows = group(np.random.default_rng(seed), between=between)
    slope = SensitivityFunction.of(rows).slope
    estimate, error, freedom, p, apart = lmer
    assert slope.mean == pytest.approx(estimate, abs=0.02 * error)
    assert (slope.error, slope.between) == pytest.approx((error, apart), rel=0.01)
    assert slope.p_value() == pytest.approx(p, rel=0.03)
    assert slope.subjects - 1 == pytest.approx(freedom, rel=0.02)
    slope = SensitivityFunction.of([replace(row, session=str(row.reference > 3.0)) for row in rows]).slope
    assert slope.mean == pytest.approx(with_sessions[0], abs=0.02 * with_sessions[1])
    assert slope.error == pytest.approx(with_sessions[1], rel=0.005)


def test_alike_subjects_have_students_interval():
    """Where all errors are alike the interval is that of the plain slopes; a subject's is that of his own line."""
    rows = [replace(row, error=0.2) for row in group(np.random.default_rng(5), error=0.2)]
    function, x = SensitivityFunction.of(rows), np.log(REFERENCES)
    lines = [linregress(x, np.log([row.fraction for row in rows[i : i + 5]])) for i in range(0, 40, 5)]
    plain = ttest_1samp([line.slope for line in lines], 0.0)
    assert function.slope.interval == pytest.approx(tuple(plain.confidence_interval()))
    assert function.slope.p_value() == pytest.approx(plain.pvalue)
    single = SensitivityFunction.of(rows[:5])
    wide = t.ppf(0.975, 3) * lines[0].stderr
    assert single.slope_of("0") == pytest.approx(
        (lines[0].slope, lines[0].slope - wide, lines[0].slope + wide)
    )
    refused(
        (lambda: single.slope_of("1"), "subject must be one of 0, got '1'"),
        (lambda: SensitivityFunction.of(rows, level=1.5), r"level must be in \[0.5, 1\), got 1.5"),
        (lambda: SensitivityFunction.of(rows, "k"), "parameter must be one of c_e, alpha, got 'k'"),
        (
            lambda: WeberFraction.of_levels([(2, 11, 10)], subject="1", reference=1.0),
            "from 0 to trials, at least 1, got 11 of 10",
        ),
        (
            lambda: WeberFraction.of_levels([(2, 5.5, 10)], subject="1", reference=1.0),
            "from 0 to trials, at least 1, got 5.5 of 10",
        ),
        (
            lambda: WeberFraction.of_levels([(1, 5, 10)], subject="1", reference=1.0),
            "levels must differ from 1",
        ),
        (lambda: subjects_for_slope(0.3, [0, 2], 0.2), "references must be above 0 and differ"),
    )


def test_a_singular_fit_is_told():
    """Two slopes that are equal by chance are known no better than their errors tell."""
    function = SensitivityFunction.of([WeberFraction(x, p0, 0.2, 0.1) for x in "ab" for p0 in (1.0, 2.0)])
    wide = norm.ppf(0.975) * 0.1 * math.sqrt(2.0) / math.log(2.0) / math.sqrt(2.0)
    assert function.slope.interval == pytest.approx((-wide, wide))
    assert all(text in str(function) for text in (
        "no more than their errors do: a singular fit", "curvature: not known without three references of a subject",
    ))  # fmt: skip


def test_exact_lines_and_sessions():
    """Without noise slopes come back whatever the sessions add; where they cannot be told, it says so."""
    shift = {"1": 0.0, "2": 0.3}
    rows = [
        WeberFraction(f"{i}", p0, 0.2 * p0**slope * math.exp(shift[session]), 0.1, session + "b" * (i == 2))
        for i, slope in enumerate((-0.5, 0.1, 0.4))
        for k, p0 in enumerate(REFERENCES)
        for session in (str(1 + (i + k) % 2),)
    ]
    function = SensitivityFunction.of(rows)
    assert (function.slope.mean, function.slope.between) == pytest.approx(
        (0.0, np.std((-0.5, 0.1, 0.4), ddof=1))
    )
    assert [function.lines[x][1] for x in "012"] == pytest.approx([-0.5, 0.1, 0.4])
    # the last subject has sessions of its own, of which the others' lines tell nothing
    assert (function.sessions, function.curvature.mean) == pytest.approx((4, 0.0), abs=1e-9)
    alone = SensitivityFunction.of(
        [WeberFraction("0", r.reference, r.fraction, 0.1, f"{k}") for k, r in enumerate(rows[:5])]
    )
    assert "cannot be told from the slopes" in str(alone)
    assert "one subject: nothing is said of others" in str(alone)
    assert math.isinf(alone.slope.interval[1])
    other = SensitivityFunction.of(
        [WeberFraction(r.subject, r.reference, r.fraction * r.reference, 0.1, r.session) for r in rows]
    )
    assert other.difference(function).mean == pytest.approx(1.0)
    refused(
        (
            lambda: other.difference(
                SensitivityFunction.of([WeberFraction("9", p0, 0.2, 0.1) for p0 in (1.0, 2.0)])
            ),
            "other must hold a subject of this function",
        )
    )


def test_what_is_left_out():
    rows = group(np.random.default_rng(1))
    odd = WeberFraction("0", 16.0, 0.9, 0.3, open=True), WeberFraction("lonely", 1.0, 0.2, 0.1)
    function = SensitivityFunction.of([*rows, *odd])
    assert function.left_out == odd
    assert function.slope == SensitivityFunction.of(rows).slope
    assert (
        "2 of 42 are left out, as their subjects have no other within the levels, or as they may lie beyond either end: 0 at 16, lonely at 1"
        in str(function)
    )
    assert WeberFraction("0", 1.0, 0.9, math.inf, open=True).open
    assert WeberFraction.of_levels([(1.5, 10, 20)], subject="0", reference=1.0).open
    rounded = WeberFraction("0", 0.1 + 0.2, 0.2, 0.1), WeberFraction("0", 0.3, 0.2, 0.1)
    few, sides = (
        "a subject with two references or more that are not open, got none",
        [(0.9, 1, 2), (1.1, 1, 2)],
    )
    refused(
        (lambda: SensitivityFunction.of(odd), few),
        (lambda: SensitivityFunction.of(rounded), few),
        (lambda: WeberFraction("0", 1.0, 0.0, 0.1), "fraction must be above 0 and finite, got 0"),
        (
            lambda: WeberFraction.of_levels(sides, subject="0", reference=1.0),
            "levels must lie on one side of 1, got 2 on 2 sides",
        ),
    )


def test_a_bound_on_a_side():
    """Thresholds beyond the levels count by their side: the likelihood is the half of Phi at the bound."""
    for ratios, right, sign in (
        ((1.1, 1.3), (11, 12), 1.0),
        ((1.3, 2.0), (20, 20), -1.0),
        ((0.9, 0.8), (11, 12), 1.0),
    ):
        row = WeberFraction.of_levels(
            [(x, n, 20) for x, n in zip(ratios, right, strict=False)], subject="0", reference=4.0
        )
        assert row.bound[1] * sign > 0.0
        far = row.about(row.bound[0] + 9.0 * row.bound[1]), row.about(row.bound[0] - 9.0 * row.bound[1])
        # nothing is known there, and the side here
        assert far[0][1] > 100.0 > 1.1 * abs(row.bound[1]) > far[1][1]
    rows = [WeberFraction("0", p0, 0.2, 0.1) for p0 in (1.0, 2.0)]
    function = SensitivityFunction.of([*rows, replace(row, bound=(math.log(0.4), 0.1))])
    assert function.slope.mean > 0.05
    assert "1 of 3 may lie beyond the levels, and count as such: 0 at 4" in str(function)
    assert function.plot().get_lines()[0].get_marker() == "v"
    assert "half of them may lie beyond" in str(
        SensitivityFunction.of([*rows, *[replace(row, bound=None)] * 2])
    )


@pytest.mark.slow
def test_the_slope_is_held_where_thresholds_lie_beyond_the_levels():
    """Three in ten do. Left out, they would bias the slope by -0.2, and 37 of 60 intervals would hold it."""
    held, means, levels = 0, [], np.exp(np.geomspace(math.log(1.05), math.log(2.0), 6))
    for seed in range(60):
        random, rows = np.random.default_rng([seed, 7]), []
        for subject in range(12):
            own, level = 1.0 + 0.2 * random.normal(), math.log(0.4) + 0.3 * random.normal()
            for p0 in REFERENCES:
                threshold = math.log1p(math.exp(level + own * math.log(p0 / 2.0)))
                correct = random.binomial(10, proportion_correct(np.log(levels), threshold, 1.25, 0.02))
                trials = [(float(ratio), int(n), 10) for ratio, n in zip(levels, correct, strict=True)]
                rows.append(WeberFraction.of_levels(trials, subject=str(subject), reference=float(p0)))
        slope = SensitivityFunction.of(rows).slope
        held += slope.interval[0] <= 1.0 <= slope.interval[1]
        means.append(slope.mean)
    print(f"held {held} of 60, bias {np.mean(means) - 1.0:+.3f}")
    assert held >= binom.ppf(5e-7, 60, 0.95)
    assert abs(np.mean(means) - 1.0) < 0.05


def test_curvature_is_seen():
    rows = [
        WeberFraction(
            r.subject, r.reference, r.fraction * math.exp(0.2 * math.log(r.reference / 2.0) ** 2), r.error
        )
        for r in group(np.random.default_rng(2), error=0.05)
    ]
    curvature = SensitivityFunction.of(rows).curvature
    assert curvature.interval[0] < 0.4 < curvature.interval[1]
    assert curvature.p_value() < 0.001


def test_from_the_file_to_the_function(tmp_path):
    """References of a file, a staircase each; subjects of a constant ratio get Weber's law."""
    made = protocol(tmp_path, SMALL.replace("trials = 10", "trials = 40\nreferences = [0.5, 1, 2, 4]"))
    for subject, limit in (("01", 1.15), ("02", 1.3), ("03", 1.2)):
        for task in made.tasks:
            if task.startswith("up"):
                run(made, subject, task, lambda trial, at=limit: trial.level > at or trial.number % 2 == 0)
    analysis = analyse(made)
    (function,) = analysis.sensitivity_functions()
    assert sorted({row.reference for row in function.fractions}) == pytest.approx([1.0725, 2.145, 4.29, 8.58])
    assert function.slope.mean == pytest.approx(0.0, abs=1e-9)
    assert 0.1 < function.fraction_at(2.145)[0] < 0.35
    assert np.diff([math.log(function.fraction_at(p0)[0]) for p0 in (1.0, math.e)]) == pytest.approx(
        function.slope.mean, abs=1e-12
    )
    assert str(function).splitlines()[0] in analysis.report()
    axes = function.plot()
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    published = "published exponent 2, definition\nunknown: four readings through the middle"
    assert published in axes.get_legend_handles_labels()[1]
    assert published not in function.plot(published=False).get_legend_handles_labels()[1]
    beside = [replace(x, name=x.name.replace("up", "up1"), design=x.design | {"reference": x.design["reference"] | {"alpha_per_ms": 1.0}})
              for x in analysis.tasks if x.name.startswith("up")]  # fmt: skip
    pair = replace(
        analysis, tasks=(*analysis.tasks, *beside)
    ).sensitivity_functions()  # around another material
    assert [x.name.split(", ")[1] for x in pair] == ["up", "up1"]
    alone = SensitivityFunction.of([row for row in function.fractions if row.subject == "01"])
    assert "p = " not in str(alone)
    assert "inf" not in str(alone)
    tasks = [replace(task, subjects=tuple(replace(x, levels=((1.5, 20, 20),), clipped=()) for x in task.subjects))
             for task in analysis.tasks if task.design.get("parameter")]  # fmt: skip
    assert (
        "the reference: no function, as no subject has two thresholds within the levels"
        in Analysis("", tuple(tasks), (), {}).report()
    )


def test_a_slope_that_was_set_comes_back(tmp_path):
    """From the file through rendered runs to the function, by an observer whose thresholds are set."""
    text = SMALL.replace('parameter = "c_e"', 'parameter = "c_e"\nlevels = [1.02, 4]\ninterval_s = 0.5')
    more = 'design = "adaptive"', "trials = 60\nreferences = [0.5, 1, 2, 4]"
    made = protocol(tmp_path, text.replace('design = "staircase"', more[0]).replace("trials = 10", more[1]))
    tasks = [task for task in made.tasks if task.startswith("up")]
    for subject, level in (("01", 0.15), ("02", 0.2), ("03", 0.25)):
        seat = PsychometricSeat(lambda p0, w=level: w * (p0 / 2.145) ** 0.5, seed=made.seed, name=subject)
        Sitting(made, subject, tasks=tasks, device="hand", simulated={"set": level}, once=True).run(
            lambda _, x=seat: x
        )
    analysis = analyse(made)
    (function,) = analysis.sensitivity_functions()
    assert function.slope.interval[0] < 0.5 < function.slope.interval[1]
    assert function.slope.mean == pytest.approx(0.5, abs=0.25)
    assert "pressed: " in str(function)
    pytest.importorskip("pandas", reason="extra `pandas` is not installed")
    rows = function.to_dataframe()
    assert sorted(rows.c_e_N_per_mm2.unique()) == pytest.approx([1.0725, 2.145, 4.29, 8.58])
    assert (rows.W_low < rows.W).all()
    assert (rows.W_high > rows.W).all()
    probing = made.tasks["probing"]
    refused(
        (
            lambda: seat.ask(probing, probing.order(seed=1, subject="x").next(), []),
            "design must vary a parameter",
        )
    )


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 4))])
def test_beside_psignifit(seed):
    """psignifit 4's threshold of the same 400 trials, at 75 %, is within half a standard error; priors differ."""
    pytest.importorskip("psignifit", reason="extra `psychometric` is not installed")
    design = AdaptiveStaircase(
        Stimulus("bone", burrlab.materials["bone"]), "c_e", levels=(1.02, 3.0), trials=400
    )
    levels = answered(design, 0.2, 0.0, np.random.default_rng(seed))
    ours = WeberFraction.of_levels(levels, subject="0", reference=1.0)
    theirs = psychometric_function(*zip(*levels, strict=True))
    assert abs(math.log(ours.fraction / (theirs.threshold - 1.0))) < 0.5 * ours.error


@pytest.mark.parametrize("stops", [(), (2,), (9, 21)])
def test_references_may_be_interleaved(tmp_path, stops):
    """Trials of one sitting in an order of their own, block by block; the same after a stop."""
    options = (
        "references = [0.5, 1, 2]\ninterleave = true\npractice = 1\nblocks = 2\ncatch = 1\nreversals = 20"
    )
    text = SMALL.replace('parameter = "c_e"', 'parameter = "c_e"\ninterval_s = 0.2')
    made = protocol(tmp_path, text.replace("trials = 10", f"trials = 8\n{options}"))
    together = ("up1", "up2", "up3")
    assert made.units == [("probing",), ("match",), together]
    # one break for all three
    assert made.minutes("up1") == pytest.approx((10 * 2 * (0.2 + 1.0) + 60.0 / 3.0) / 60.0)
    assert {made.tasks_of(x).index("up2") - made.tasks_of(x).index("up1") for x in made.subjects} == {1}
    asked, left = [], [*stops, 1000]

    class Seen(PsychometricSeat):
        def ask(self, design, trial, rendered):
            if len(asked) == left[0]:
                raise KeyboardInterrupt(left.pop(0))
            asked.append((design.reference.name, trial.phase, trial.number, trial.block))
            return super().ask(design, trial, rendered)

        def progress(self, text):
            assert not text or text.endswith(f"of {3 if 'practice' in text else 27}, " + text.split(", ")[1])

    seat = Seen(lambda p0: 0.3, seed=1, name="01")
    for _ in (*stops, None):
        sitting = Sitting(made, "01", tasks=together[1:2], device="hand", simulated={"set": 1}, once=True)
        try:
            sitting.run(lambda task: seat)
        except KeyboardInterrupt:
            continue
    assert [block for *_, block in asked] == sorted(block for *_, block in asked)
    assert Counter(name for name, *_ in asked) == dict.fromkeys(("bone c_e x0.5", "bone", "bone c_e x2"), 10)
    assert "".join(name[-1] for name, *_ in asked) == INTERLEAVED
    assert all(subject.complete for task in analyse(made).tasks for subject in task.subjects)
    plain = protocol(tmp_path, text.replace("trials = 10", "trials = 8"))
    assert "interleaved" not in plain.to_dict()["experiment"]
    refused(
        (
            lambda: protocol(tmp_path, text.replace("trials = 10", "trials = 8\ninterleave = true")),
            "interleave goes with references",
        )
    )


INTERLEAVED = "25ee55e222e2555ee2e5e522e2e552"


def test_what_was_pressed_stands_beside():
    """W falls with the force, which rises with the reference: at equal force the slope is another one."""
    random, rows = np.random.default_rng(6), []
    for i, slope in enumerate((-0.5, 0.1, 0.4)):
        for p0 in REFERENCES:
            force = 0.8 * p0**0.3 * math.exp(0.2 * random.normal())
            rows.append(WeberFraction(f"{i}", p0, 0.2 * p0**slope * force**-0.5, 0.1, force=force))
    function = SensitivityFunction.of(rows)
    assert function.at_equal_force.mean == pytest.approx(0.0, abs=1e-9)
    assert function.slope.mean < -0.05
    mean = np.mean([row.force for row in rows if row.reference == 0.5])
    assert f"pressed: {mean:.2g} N at 0.5" in str(function)
    collinear = SensitivityFunction.of([replace(row, force=row.reference**0.3) for row in rows])
    assert collinear.at_equal_force is None
    assert "corrects nothing: cannot be told from the references" in str(collinear)
    assert SensitivityFunction.of([replace(row, force=None) for row in rows[:9]]).at_equal_force is None


def test_a_reference_may_have_trials_of_its_own(tmp_path):
    def made(trials, references="[0.5, 1, 2]"):
        text = SMALL.replace("trials = 10", f"trials = {trials}\nreferences = {references}\ncatch = 2")
        return protocol(tmp_path, text).tasks

    tasks = made([20, 10, 20])
    assert [tasks[f"up{i}"].trials for i in (1, 2, 3)] == [20, 10, 20]
    assert tasks["up2"].to_dict() == made(10)["up2"].to_dict()
    each = "trials must be a whole number from 0 to 10000, or one for each of references"
    refused(
        (lambda: made([20, 10]), each),
        (lambda: made([20, 10, 20000]), each),
        (lambda: made([20, 10, 0.5]), each),
        (lambda: made([20, 0, 20]), "trials must be at least 1, got 0"),
    )


def test_catch_trials(tmp_path):
    """They are easy, spread, counted apart and leave the staircase's own trials as they are."""
    made = protocol(
        tmp_path, SMALL.replace("trials = 10", "trials = 40\nreversals = 40\ncatch = 4\nblocks = 2")
    )
    for name in ("01", "02"):
        run(made, name, "up", lambda trial, x=name: x == "01" and trial.phase == "main" and trial.level > 1.2)
    (task,) = (task for task in analyse(made).tasks if task.name == "up")
    subject, lines = task.subjects[0], "\n".join(group_lines(task))
    assert (subject.catch, subject.complete) == ((2.0, 0, 4), True)
    assert all(text in lines for text in (
        "01: 0 of 4 catch trials right, so lapses (random answers) in 80 to 100 %, if a ratio of 2 is felt, and more than",
        "02: scores are below chance (p < 0.0001): were answers swapped?",
    ))  # fmt: skip
    plain = protocol(tmp_path, SMALL.replace("trials = 10", "trials = 40\nreversals = 40\nblocks = 2")).order(
        "01", "up"
    )
    give(Mock(), plain, right=lambda trial: trial.level > 1.2)
    levels = Counter(trial.level for trial, _ in plain.answered)
    assert {level: n for level, _, n in subject.levels} == pytest.approx(levels)
    phases = [trial.phase for trial in give(Mock(), made.order("01", "up"), right=lambda trial: True)]
    assert [phases[i : i + 11].count("catch") for i in range(0, 44, 11)] == [1, 1, 1, 1]
    refused(
        (
            lambda: protocol(tmp_path, SMALL.replace("trials = 10", "trials = 40\ncatch = 41")),
            "catch must be at most the 40 trials, got 41",
        )
    )


def test_what_a_device_could_not_render():
    """Trials whose force was clipped are out of the Weber fraction, not out of the levels."""
    levels, clipped = ((1.2, 9, 12), (1.5, 20, 20)), ((1.2, 3, 4), (1.5, 20, 20))
    made = SubjectThreshold(
        "01", True, 32, 32, levels, 1.2, None, "", None, clipped=(*clipped, (2.0, 1, 1)), catch=(2.0, 5, 5)
    )
    assert made.rendered() == [(1.2, 6, 8), (2.0, 4, 4)]
    assert replace(made, clipped=((1.2 * (1 + 1e-15), 3, 4),)).rendered()[0] == (
        1.2,
        6,
        8,
    )  # one level of a staircase
    design = {"parameter": "c_e", "mode": "probing", "reference": {"c_e_N_per_mm2": 2.0}}
    tasks = tuple(
        ThresholdTask(name, design | {"reference": {"c_e_N_per_mm2": p0}}, 0.95, (made,), (), 0, 0, "")
        for name, p0 in (("a", 1.0), ("b", 2.0))
    )
    (function,) = Analysis("", tasks, (), {}).sensitivity_functions()
    assert function.fractions[0] == WeberFraction.of_levels(
        made.rendered(), subject="01", reference=1.0, session="0"
    )
    assert "01: limits shortened the force in 25 trials" in "\n".join(group_lines(tasks[0]))


def test_few_thresholds_that_differ_much_have_an_open_interval():
    two = [SubjectThreshold(x, 9, False, 9, (), 3.0**y, None, "", None) for x, y in (("a", 0.02), ("b", 2.0))]
    task = ThresholdTask("up", {}, 0.95, tuple(two), (), 0, 0, "")
    threshold, near, far = task.group_threshold
    assert (near, math.isinf(far)) == (pytest.approx(1.0), True)
    assert math.log(threshold) == pytest.approx(0.2 * math.log(3.0))
    assert "1.000 to no end, as the subjects differ much" in "\n".join(group_lines(task))
    assert task.plot_thresholds().get_xlim()[1] < 20


def slopes_held(slope, subjects, between, sets, random, nested=False):
    """How many groups' intervals hold the slope; the error of the mean; a line of these figures."""
    means = []
    for _ in range(sets):
        day, rows = 0.3 * random.normal(), group(random, slope, between, subjects)
        if nested:
            rows = [replace(r, fraction=r.fraction * math.exp(day * (r.reference > 3.0)), session=str(r.reference > 3.0))
                    for r in rows]  # fmt: skip
        means.append(SensitivityFunction.of(rows).slope)
    held = sum(x.interval[0] <= slope <= x.interval[1] for x in means)
    bias = float(np.mean([x.mean for x in means])) - slope
    half = float(np.median([x.interval[1] - x.mean for x in means]))
    return (
        held,
        bias,
        (
            f"slope {slope:+g}, {subjects} subjects, sd {between}: held {100 * held / sets:.1f} %, bias {bias:+.3f}, "
            f"half width {half:.2f}"
        ),
    )


def test_the_slope_is_held_in_a_few_groups():
    held, bias, line = slopes_held(1.0, 6, 0.2, 300, np.random.default_rng(7))
    assert binom.ppf(5e-7, 300, 0.95) <= held, line
    assert abs(bias) < 0.05, line


@pytest.mark.slow
@pytest.mark.parametrize("nested", [False, True], ids=["no sessions", "nested sessions"])
def test_how_often_the_slope_is_held(nested):
    """Shared effects of sessions that go with the references make the interval hold more often, never less."""
    sets, total = 2000, 0
    cases = list(itertools.product((0.0,) if nested else (-1.0, 0.0, 1.0), (6, 10, 20), (0.2, 0.4)))
    random = np.random.default_rng(1)
    for slope, subjects, between in cases:
        held, bias, line = slopes_held(slope, subjects, between, sets, random, nested)
        print(line)
        assert abs(bias) < 0.05
        total += held
    sets *= len(cases)
    most = sets if nested else binom.ppf(1.0 - 5e-7, sets, 0.95)
    assert binom.ppf(5e-7, sets, 0.95) <= total <= most, total


@pytest.mark.slow
@pytest.mark.parametrize("between", [0.2, 0.4])
def test_subjects_for_slope(between):
    """The subjects that it names suffice, by simulation; one less does not."""
    sets, error = 1000, 0.3
    known, distinct = subjects_for_slope(error, REFERENCES, between)
    random = np.random.default_rng(3)

    def functions(subjects, slope):
        return [SensitivityFunction.of(group(random, slope, between, subjects, error)) for _ in range(sets)]

    for n in (known - 1, known):
        squares = np.array([(x.slope.interval[1] - x.slope.mean) ** 2 for x in functions(n, 0.0)])
        away = (float(np.mean(squares)) - 0.3**2) * math.sqrt(sets) / float(np.std(squares))
        print(f"sd {between}, {n} subjects: half width {math.sqrt(np.mean(squares)):.3f}")
        assert away < 4.9 if n == known else away > -4.9
    for n in (distinct - 1, distinct):
        differences = [a.difference(b) for a, b in zip(functions(n, 1.0), functions(n, 0.0), strict=True)]
        power = sum(x.p_value() < 0.05 for x in differences)
        print(f"sd {between}, {n} subjects: slopes 1 apart in {power / sets:.1%}")
        assert (
            power >= binom.ppf(5e-7, sets, 0.8) if n == distinct else power <= binom.ppf(1 - 5e-7, sets, 0.8)
        )


def answered(design, threshold, bias, random):
    """Levels, correct answers and trials of a Gaussian observer who prefers an interval and lapses in 3 %."""
    track, right, trials = design.track(), Counter(), Counter()
    while (level := track.level()) is not None:
        d = 0.9539 * abs(math.log(level)) / threshold / math.sqrt(2.0)
        p = 0.97 * float(ndtr(d + bias * random.choice((-1, 1)))) + 0.015
        right[level] += (correct := bool(random.random() < p))
        trials[level] += 1
        track.update(correct)
    return [(level, right[level], n) for level, n in trials.items()]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["adaptive", "staircase"])
def test_from_trials(kind):
    """Six subjects who differ by 0.2, five references, W from 0.07 to 0.7."""
    bone, sets, total = Stimulus("bone", burrlab.materials["bone"]), 500, 0
    design = {
        "adaptive": AdaptiveStaircase(bone, "c_e", levels=(1.02, 3.0), trials=60),
        "staircase": Staircase(bone, "c_e", start=2.5, trials=60, reversals=30),
    }[kind]
    random = np.random.default_rng(2)
    for slope in (-1.0, 0.0, 1.0):
        found, left_out = [], 0
        for _ in range(sets):
            rows = []
            for i in range(6):
                own, level, bias = slope + 0.2 * random.normal(), 0.2 * random.normal(), 0.3 * random.normal()
                for p0 in np.geomspace(1 / 3, 3, 5):
                    w = 0.22 * math.exp(level) * p0**own
                    levels = answered(design, math.log1p(w), bias, random)
                    rows.append(WeberFraction.of_levels(levels, subject=str(i), reference=p0))
            function = SensitivityFunction.of(rows)
            found.append(function.slope)
            left_out += len(function.left_out)
        held = sum(x.interval[0] <= slope <= x.interval[1] for x in found)
        bias = float(np.mean([x.mean for x in found])) - slope
        half = float(np.median([x.interval[1] - x.mean for x in found]))
        print(f"{kind}, slope {slope:+g}: held {100 * held / sets:.1f} %, bias {bias:+.3f}, half width {half:.2f}, "
              f"left out {left_out / sets / 30:.1%}")  # fmt: skip
        assert abs(bias) < 0.05
        total += held
    # not too few to be chance, nor many more
    assert binom.ppf(0.001, 3 * sets, 0.95) <= total <= binom.ppf(0.999, 3 * sets, 0.97), total


@pytest.mark.slow
def test_trials_at_the_ends_know_a_slope_better():
    """300 trials of a subject, a fifth in the middle and the rest at the ends, beside five equal references."""
    bone, sets, variance = Stimulus("bone", burrlab.materials["bone"]), 1000, Counter()
    up_down = Staircase(bone, "c_e", start=2.5, trials=60, reversals=60)
    adaptive = AdaptiveStaircase(bone, "c_e", levels=(1.02, 3.0), trials=60)
    plans = {
        "up-down, equal": [(p0, up_down) for p0 in np.geomspace(0.25, 4.0, 5).tolist()],
        "adaptive, equal": [(p0, adaptive) for p0 in np.geomspace(0.25, 4.0, 5).tolist()],
        "adaptive, the ends": [
            (p0, replace(adaptive, trials=n)) for p0, n in ((0.25, 120), (1.0, 60), (4.0, 120))
        ],
    }
    for slope, (name, tasks) in itertools.product((-0.5, 0.0, 0.5), plans.items()):
        random, found = np.random.default_rng(4), []
        for _ in range(sets):
            level, bias = 0.2 * random.normal(), 0.3 * random.normal()
            rows = [
                WeberFraction.of_levels(
                    answered(design, math.log1p(0.2 * math.exp(level) * p0**slope), bias, random),
                    subject="0", reference=p0,
                ) for p0, design in tasks
            ]  # fmt: skip
            found.append(SensitivityFunction.of(rows).lines["0"][1])
        variance[name] += float(np.var(found)) / 3.0
        print(f"{name}, slope {slope:+g}: bias {np.mean(found) - slope:+.3f}, sd {np.std(found):.3f}")
        assert abs(np.mean(found) - slope) < 0.05
    ratios = {name: variance["adaptive, the ends"] / v for name, v in variance.items()}
    print(", ".join(f"{x:.2f} of the trials of {name}" for name, x in ratios.items()))
    assert (ratios["up-down, equal"] < 0.7, ratios["adaptive, equal"] < 0.9) == (True, True)
