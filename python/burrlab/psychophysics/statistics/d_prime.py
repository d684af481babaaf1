"""How well one subject tells two stimuli apart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

from scipy.stats import binomtest

from burrlab.provenance import provenance
from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.rules import RuleName, TaskName, rule_of
from burrlab.psychophysics.statistics.exact_interval import exact_interval, proportion_interval
from burrlab.psychophysics.statistics.likelihood import CorrectionName, Outcomes

MethodName: TypeAlias = Literal["exact", "profile", "proportion"]

METHODS: tuple[MethodName, ...] = get_args(MethodName)
CORRECTIONS: tuple[CorrectionName, ...] = get_args(CorrectionName)

_CRITERIA = {
    ("same-different", "differencing"): "k [sd]: observations further apart than k are different",
    ("same-different", "independent-observations"): "c [z]: 0 is unbiased, above 0 favours same",
    ("abx", "differencing"): "c [z]: 0 is unbiased, above 0 favours second",
    ("abx", "independent-observations"): "c [z]: 0 is unbiased, above 0 favours second",
    ("2ifc", "differencing"): "c [z]: 0 is unbiased, above 0 favours second",
    ("2ifc", "independent-observations"): "c [z]: 0 is unbiased, above 0 favours second",
}


@dataclass(frozen=True)
class DPrime:
    """d' of one subject under one rule.

    Attributes
    ----------
    task, rule : str
        As `rule_of` has them.
    estimate : float
        Of greatest likelihood, in [0, inf]: 0 where there are no more hits than false alarms, inf where the likelihood
        rises without end.
    interval : (float, float)
        Its ends in [0, inf]; inf is an open end.
    level : float
        Of the interval.
    method : {"exact", "profile", "proportion"}
        Of the interval.
    standard_error : float or None
        From the information at the estimate; None unless the interval excludes 0 and the estimate is finite.
    criterion : float
        At the estimate; infinite where a rate is 0 or 1, nan where both are, in a perfect score.
    criterion_meaning : str
        Its name, unit and direction.
    corrected : float
        d' of the rates after `correction`; with "none" it is the estimate. The interval takes no correction.
    correction : {"none", "log-linear", "half"}
    undetermined : bool
        Any d' fits as well as any other (one answer always, or no trial of one kind): estimate 0, interval [0, inf).
    counts : Counts
    """

    task: TaskName
    rule: RuleName
    estimate: float
    interval: tuple[float, float]
    level: float
    method: MethodName
    standard_error: float | None
    criterion: float
    criterion_meaning: str
    corrected: float
    correction: CorrectionName
    undetermined: bool
    counts: Counts

    @property
    def open_above(self) -> bool:
        """The answers set no upper limit."""
        return math.isinf(self.interval[1])

    @property
    def excludes_zero(self) -> bool:
        return self.interval[0] > 0.0

    def __str__(self) -> str:
        low, high = self.interval
        above = "open)" if self.open_above else f"{high:.2f}]"
        lines = [
            f"d' {self.estimate:.2f}, {100 * self.level:g} % [{low:.2f}, {above} ({self.rule}, {self.method})"
        ]
        if self.undetermined:
            lines.append(
                "the answers say nothing of d': one answer was always given, or one kind of trial is missing"
            )
        if self.standard_error is not None:
            lines.append(f"standard error {self.standard_error:.2f}")
        if self.correction != "none":
            lines.append(f"corrected d' {self.corrected:.2f} ({self.correction})")
        name, meaning = self.criterion_meaning.split(" ", 1)
        lines.append(f"criterion {name} {self.criterion:.2f} {meaning}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """For JSON: infinite values as None, with `open_above` beside them; with provenance."""

        def finite(value: float) -> float | None:
            return value if math.isfinite(value) else None

        values = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "counts"}
        for name in ("estimate", "corrected", "criterion"):
            values[name] = finite(values[name])
        return {
            **values,
            "interval": [finite(end) for end in self.interval],
            "infinite": math.isinf(self.estimate),
            "open_above": self.open_above,
            "counts": {
                **{
                    name: getattr(self.counts, name) for name in ("hits", "signals", "false_alarms", "noises")
                },
                "by_type": {name: list(both) for name, both in self.counts.by_type.items()},
            },
            "provenance": provenance(),
        }


def d_prime(
    counts: Counts,
    *,
    rule: str,
    level: float = 0.95,
    method: str = "exact",
    correction: str = "none",
) -> DPrime:
    """Estimate d' with an interval on [0, inf).

    hits ~ Binomial(signals, H(d', c)), false alarms ~ Binomial(noises, F(d', c)), the criterion c free.

    Parameters
    ----------
    counts : Counts
    rule : {"independent-observations", "differencing"}
    level : float, default 0.95
        Of the interval, in (0, 1).
    method : {"exact", "profile", "proportion"}, default "exact"
        "exact": the d' that the likelihood-ratio test keeps, with its exact distribution at the worst criterion. It
        holds the truth at least as often as it says.
        "profile": the same with chi-square's distribution; fast, but short where all or nearly all answers are correct.
        "proportion" (ABX, two intervals): Clopper and Pearson's interval of the proportion correct, carried to d'. It
        takes the observer as unbiased, and both kinds of trial together.
    correction : {"none", "log-linear", "half"}, default "none"
        "log-linear": half an answer more in each cell (Hautus 1995). "half": rates of 0 and 1 alone become 1/(2n) and
        1 - 1/(2n) (Macmillan and Kaplan 1985). For `corrected` alone.

    Returns
    -------
    DPrime

    Raises
    ------
    ValueError
        If the rule, method or correction is unknown, the level not in (0, 1), "proportion" asked of same-different, or
        "exact" of more than 4 million possible outcomes (2000 trials of each kind).

    Notes
    -----
    In same-different and ABX d' has no sign: 0 is a boundary, where the information is 0, and an interval of the kind
    estimate +- 1.96 standard errors fails (see `docs/psychophysics.md`). "exact" includes 0 unless an exact one-sided
    test at 1 - level rejects it, "profile" at about half of that.

    References
    ----------
    M. J. Hautus, Behavior Research Methods, Instruments, and Computers 27, 46-51, 1995.
    N. A. Macmillan, H. L. Kaplan, Psychological Bulletin 98, 185-199, 1985.

    Examples
    --------
    >>> counts = Counts("same-different", hits=5, signals=6, false_alarms=2, noises=6)
    >>> print(d_prime(counts, rule="differencing"))
    d' 2.73, 95 % [0.00, 4.61] (differencing, exact)
    criterion k 1.37 [sd]: observations further apart than k are different
    """
    law = rule_of(counts.task, rule)
    check_level(level)
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if correction not in CORRECTIONS:
        raise ValueError(f"correction must be one of {', '.join(CORRECTIONS)}, got {correction!r}")
    outcome = Outcomes.of(counts)
    estimate, criterion = (float(x) for x in outcome.estimate(law))
    if method == "exact":
        interval = exact_interval(counts, law, level)
    elif method == "profile":
        low, high = outcome.profile_interval(law, level)
        interval = float(low), float(high)
    elif counts.task == "same-different":
        raise ValueError("method must be exact or profile for same-different, got 'proportion'")
    else:
        interval = proportion_interval(counts, law, level)
    error = float(outcome.standard_error(law))
    return DPrime(
        task=counts.task,
        rule=law.name,
        estimate=estimate,
        interval=interval,
        level=level,
        method=method,
        standard_error=error if interval[0] > 0.0 and math.isfinite(error) else None,
        criterion=criterion,
        criterion_meaning=_CRITERIA[counts.task, law.name],
        corrected=estimate if correction == "none" else float(law.invert(*outcome.corrected(correction))[0]),
        correction=correction,
        undetermined=bool(outcome.undetermined),
        counts=counts,
    )


def score_interval(counts: Counts, level: float = 0.95) -> tuple[float, float]:
    """Clopper and Pearson's exact interval of the proportion of correct answers.

    Raises
    ------
    ValueError
        If the level is not in (0, 1).

    Examples
    --------
    >>> low, high = score_interval(Counts("abx", hits=5, signals=5, false_alarms=1, noises=5))
    >>> print(f"{low:.3f} {high:.3f}")
    0.555 0.997
    """
    check_level(level)
    interval = binomtest(counts.score, counts.trials).proportion_ci(level, method="exact")
    return float(interval.low), float(interval.high)


def binomial_test(counts: Counts) -> float:
    """The probability of this score or more by chance, 1/2 a trial: an exact one-sided p value.

    It holds at any bias where both kinds of trial are equally frequent. Where they are not, an observer who always gives
    the more frequent answer is above 1/2.

    Examples
    --------
    >>> print(f"{binomial_test(Counts('abx', hits=5, signals=5, false_alarms=1, noises=5)):.4f}")
    0.0107
    """
    return float(binomtest(counts.score, counts.trials, 0.5, alternative="greater").pvalue)


def check_level(level: float) -> None:
    if not 0.0 < level < 1.0:
        raise ValueError(f"level must be above 0 and below 1, got {level}")
