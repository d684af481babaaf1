"""The psychometric function: input and results of psignifit, and the fit of a known observer."""

import math
import subprocess
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import beta
from session_scenes import refused

from burrlab.psychophysics.psychometric import ThresholdPosterior, proportion_correct, psychometric_function
from burrlab.psychophysics.staircase import gaussian_correct

LEVELS = (1.03, 1.06, 1.12, 1.25, 1.5)
THRESHOLD = math.log(1.12)


def made(levels=LEVELS, correct=(21, 24, 30, 37, 40), trials=(40,) * 5, **options):
    pytest.importorskip("psignifit", reason="extra `psychometric` is not installed")
    return psychometric_function(levels, correct, trials, **options)


@pytest.fixture(scope="module")
def fitted():
    return made(parameter="c_e", reference=2.145)


def test_many_trials_return_the_observer():
    """Expected numbers of a Weibull observer, 4000 trials per level, give its parameters back."""
    levels = (*LEVELS, 2.0, 3.0)
    shares = [0.98 - 0.48 * 2.0 ** -((math.log(level) / THRESHOLD) ** 1.4) for level in levels]
    found = made(levels, [round(4000 * share) for share in shares], [4000] * 7)
    assert (math.log(found.threshold), found.slope, found.lapse) == (
        pytest.approx(THRESHOLD, rel=0.02), pytest.approx(1.4, rel=0.03), pytest.approx(0.04, abs=0.005),
    )  # fmt: skip
    for value, (low, high) in (
        (math.exp(THRESHOLD), found.interval),
        (1.4, found.slope_interval),
        (0.04, found.lapse_interval),
    ):
        assert low < value < high
    assert found.at_bounds == ()


def test_what_is_said(fitted):
    assert (fitted.guess_rate, fitted.proportion, fitted.level, fitted.ratios) == (0.5, 0.75, 0.95, LEVELS)
    assert fitted.interval[0] < fitted.threshold < fitted.interval[1]
    change, low, high = fitted.just_noticeable()
    assert change == pytest.approx(2.145 * (fitted.threshold - 1))
    assert (low, high) == pytest.approx([2.145 * (end - 1) for end in fitted.interval])
    lines = str(fitted).splitlines()
    assert lines[0].startswith("75 % correct (guess rate 0.5, without lapses) at a ratio of 1.12, 95 % ")
    assert lines[1].startswith("just-noticeable increase of c_e 0.26")
    assert "N/mm^2" in lines[1]
    assert "200 trials" in lines[2]
    assert fitted.provenance["psignifit"]
    assert fitted.proportion_at([1.0 + 1e-9]) == pytest.approx(0.5, abs=1e-6)
    at = fitted.proportion_at([fitted.threshold, 1 / fitted.threshold])
    assert at == pytest.approx(0.5 + 0.25 * (1 - fitted.lapse))


def test_below_and_above_are_pooled_at_the_same_distance(fitted):
    below = made([1 / level for level in LEVELS], parameter="alpha", reference=0.087)
    assert (below.side, below.threshold, below.just_noticeable()[0]) == (
        "below",
        pytest.approx(fitted.threshold, rel=1e-6),
        pytest.approx(0.087 * (1 - 1 / fitted.threshold), rel=1e-6),
    )
    assert "just-noticeable decrease of alpha" in str(below)
    levels = [*LEVELS, *(1 / level for level in LEVELS)]
    both = made(levels, [11, 14, 15, 18, 20, 10, 10, 15, 19, 20], [20] * 10)
    assert (both.side, both.ratios, both.correct, both.trials, both.threshold, both.just_noticeable()) == (
        "both", pytest.approx(LEVELS), fitted.correct, fitted.trials, pytest.approx(fitted.threshold, rel=1e-6), None,
    )  # fmt: skip


def test_ends_that_the_prior_sets_and_thresholds_beyond_the_levels_are_said(fitted):
    weak = made(correct=(20, 21, 20, 22, 26))
    assert "extrapolated: the levels go from 1.03 to 1.5" in str(weak)
    assert "extrapolated" not in str(fitted)
    assert [str(made(correct=right)).split(" (p < 0.0001)")[0] for right in ((12, 9, 8, 5, 4), (40, 35, 30, 25, 20))] == [
        "scores are below chance", "scores fall as the difference grows",
    ]  # fmt: skip
    assert "the upper end of the threshold is set by the prior, not by the data" in str(weak)
    assert ("threshold", "lower") in made(LEVELS[:2], [40, 40], [40] * 2).at_bounds


def test_a_staircase_s_levels_are_no_mistake():
    """psignifit warns of single trials and of many levels; warnings are errors here."""
    draws = np.random.default_rng(4)
    levels = [math.exp(THRESHOLD * math.exp(draws.normal(0.0, 0.8))) for _ in range(30)]
    correct = [int(draws.random() < gaussian_correct(math.log(level), THRESHOLD)) for level in levels]
    found = made(levels, correct, [1] * 30)
    assert sum(found.trials) == 30
    assert 1.0 < found.interval[0] < found.threshold < found.interval[1]


def test_another_warning_of_psignifit_is_passed_on(monkeypatch):
    psignifit = pytest.importorskip("psignifit", reason="extra `psychometric` is not installed")
    values = {"threshold": -2.0, "width": 1.5, "lambda": 0.02, "eta": 0.1}
    ends = {name: {"0.95": (value - 0.1, value + 0.1)} for name, value in values.items()}

    def warns(*_, **__):
        warnings.warn("something new", UserWarning, stacklevel=1)
        return SimpleNamespace(parameter_estimate=values, confidence_intervals=ends)

    monkeypatch.setattr(psignifit, "psignifit", warns)
    with pytest.warns(UserWarning, match="something new"):
        assert made().lapse == 0.04


def test_the_plot_shows_data_curve_and_threshold(fitted):
    axes = fitted.plot()
    assert axes.get_xlabel() == "c_e, ratio to the reference's 2.145 N/mm^2 [1]"
    assert axes.get_ylabel() == "proportion correct [1]"
    bars = axes.collections[0].get_segments()
    lows = [beta.ppf(0.025, k, 41 - k) for k in (21, 24, 30, 37, 40)]
    assert [bar[0][1] for bar in bars] == pytest.approx(lows)
    assert bars[-1][1][1] == 1.0
    assert [text.get_text() for text in axes.get_xticklabels()] == ["1.03", "1.06", "1.12", "1.25", "1.5"]
    said = [f"threshold {fitted.threshold:.3g}, 95 % interval", "chance"]
    assert [text.get_text() for text in axes.texts] == said
    # The whole interval lies in the frame, and the curve spans it.
    curve, span = axes.lines[0].get_xdata(), axes.lines[1].get_xdata()
    assert axes.get_xlim()[0] < span[0] < span[1] < axes.get_xlim()[1] <= curve[-1]


def test_no_psignifit(monkeypatch):
    monkeypatch.setitem(sys.modules, "psignifit", None)
    refused(
        (
            lambda: psychometric_function(LEVELS, [20] * 5, [40] * 5),
            r"needs psignifit \(GPL\): pip install 'burrlab\[psychometric\]'",
        ),
        error=ImportError,
    )


def test_psignifit_is_imported_when_asked_for_only():
    program = "import sys, burrlab.psychophysics.psychometric; sys.exit('psignifit' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False, timeout=60).returncode == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"correct": [1, 2]}, r"levels, correct and trials must be equally many, got 5, 2 and 5"),
        ({"levels": [1.0, *LEVELS[1:]]}, r"levels must differ from 1, got 1"),
        ({"levels": [1.1, 1.1, 1 / 1.1, 1.1, 1.1]}, r"levels must hold at least two different differences from 1, got 1"),
        ({"correct": [41, 24, 30, 37, 40]}, r"correct must be from 0 to trials, at least 1, got 41 of 40"),
        ({"correct": [0] * 5, "trials": [0] * 5}, r"correct must be from 0 to trials, at least 1, got 0 of 0"),
        ({"parameter": "force"}, r"parameter must be one of c_e, alpha, got 'force'"),
        ({"reference": 0.0}, r"reference must be above 0, got 0.0"),
        ({"level": 95}, r"level must be in \[0.5, 1\), got 95"),
        ({"correct": [21.5, 24, 30, 37, 40]}, "from 0 to trials, at least 1, got 21.5 of 40"),
    ],
)  # fmt: skip
def test_refusals(change, message):
    arguments = {"levels": LEVELS, "correct": [21, 24, 30, 37, 40], "trials": [40] * 5, **change}
    refused((lambda: psychometric_function(**arguments), message), error=(ValueError, TypeError))


@pytest.mark.slow
def test_the_posterior_is_that_of_questplus():
    """Levels in the same order and the same posterior after 60 answers, with the parameters' grid of ours."""
    xarray = pytest.importorskip("xarray", reason="questplus is not installed")
    questplus = pytest.importorskip("questplus", reason="questplus is not installed")
    ours, random = ThresholdPosterior(0.02, 1.0), np.random.default_rng(1)
    thresholds, slopes, lapses = (np.unique(column) for column in ours._grid)
    axes = {"threshold": thresholds, "slope": slopes, "lapse_rate": lapses}

    class QuestPlus(questplus.QuestPlus):
        def _gen_likelihoods(self):
            shape = (len(ours.differences), *map(len, axes.values()))
            correct = ours._correct.reshape(shape)
            return xarray.DataArray(
                [correct, 1 - correct],
                coords={"response": ["right", "wrong"], "intensity": ours.differences, **axes},
                dims=["response", "intensity", *axes],
            )

    theirs = QuestPlus(
        stim_domain={"intensity": ours.differences}, param_domain=axes,
        outcome_domain={"response": ["right", "wrong"]}, prior={"lapse_rate": (1 - lapses) ** 9},
        func="weibull", stim_scale="linear",
    )  # fmt: skip
    for _ in range(60):
        level = ours.most_informative()
        assert theirs.next_stim["intensity"] == level
        right = random.random() < proportion_correct(level, 0.2, 1.25, 0.02)
        ours.update(level, int(right))
        theirs.update(stim={"intensity": level}, outcome={"response": "right" if right else "wrong"})
    np.testing.assert_allclose(theirs.posterior.to_numpy().ravel(), ours.weights(), rtol=1e-9, atol=1e-15)
