"""Two one-sided t tests: is a signed quantity within +-delta?"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr
from scipy.stats import chi2
from scipy.stats import t as student

from burrlab.psychophysics.rules import Floats
from burrlab.psychophysics.statistics.equivalence import WANTED_POWER, decision_text
from burrlab.psychophysics.statistics.group_d_prime import check_level
from burrlab.psychophysics.statistics.subject_tests import finite_values, probability_text

_QUANTILES = 2000


@dataclass(frozen=True)
class SignedEquivalence:
    """The outcome of two one-sided t tests.

    Attributes
    ----------
    delta, level : float
    n : int
        Subjects.
    mean, sem : float
    interval : tuple of float
        Of level 1 - 2 (1 - level): within +-delta exactly where the tests reject.
    p_value : float
        The larger of the two.
    equivalent : bool
    power : float
        Probability of that at a mean of 0, if the scatter is as seen.
    decidable_delta : float
        The smallest delta that would have a power of 80 %.
    """

    delta: float
    level: float
    n: int
    mean: float
    sem: float
    interval: tuple[float, float]
    p_value: float
    equivalent: bool
    power: float
    decidable_delta: float

    @property
    def sentence(self) -> str:
        """The outcome in plain words."""
        low, high = self.interval
        ends = (
            f"{low:.3g} to {high:.3g} at {100 * (2 * self.level - 1):.4g} %, {probability_text(self.p_value)}"
        )
        if self.equivalent:
            return f"Equivalent: within +-{self.delta:g} ({ends})."
        return f"Not shown to be equivalent: beyond +-{self.delta:g} is possible ({ends}). That does not show a difference."

    @property
    def design_sentence(self) -> str:
        """What so many subjects could decide."""
        size = f"{self.n} subjects"
        return decision_text(size, self.delta, self.power, self.decidable_delta, quantity="the mean")

    def __str__(self) -> str:
        return f"{self.sentence}\n{self.design_sentence}"

    def to_dict(self) -> dict[str, Any]:
        return asdict(self) | {"sentence": self.sentence, "design_sentence": self.design_sentence}


def tost(values: ArrayLike, *, delta: float, level: float = 0.95) -> SignedEquivalence:
    """Whether the mean of signed values, one a subject, is within +-delta: biases, log ratios of thresholds.

    Parameters
    ----------
    values : array_like, shape (n,)
        Two at least.
    delta : float
        In the values' unit, set before the first answer, > 0.
    level : float, optional
        1 - the error rate.

    Raises
    ------
    ValueError
        If there are less than two values, one is not finite, they have no scatter, delta is not above 0, or the level is not in [0.5, 1).

    References
    ----------
    Schuirmann, J. Pharmacokinet. Biopharm. 15, 657 (1987).

    Examples
    --------
    >>> print(tost([0.1, -0.2, 0.05, 0.0, 0.15, -0.1], delta=0.2).sentence)
    Equivalent: within +-0.2 (-0.107 to 0.107 at 90 %, p = 0.0066).
    """
    check_level(level)
    x = finite_values(values)
    if len(x) < 2:
        raise ValueError(f"values must hold at least 2, got {len(x)}")
    if not 0.0 < delta < math.inf:
        raise ValueError(f"delta must be a number above 0, got {delta}")
    n, mean, sem = len(x), float(np.mean(x)), float(np.std(x, ddof=1)) / math.sqrt(len(x))
    if sem == 0.0:
        raise ValueError("values must differ, got the same one for all")
    p_value = float(max(student.sf((mean + delta) / sem, n - 1), student.cdf((mean - delta) / sem, n - 1)))
    wide = float(student.ppf(level, n - 1)) * sem
    low, high = 0.0, 1.0
    while _power(high, n, level) < WANTED_POWER:
        high *= 2.0
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _power(middle, n, level) >= WANTED_POWER else (middle, high)
    return SignedEquivalence(
        delta=float(delta),
        level=level,
        n=n,
        mean=mean,
        sem=sem,
        interval=(mean - wide, mean + wide),
        p_value=p_value,
        equivalent=p_value <= 1.0 - level,
        power=_power(delta / sem, n, level),
        decidable_delta=high * sem,
    )


def _power(delta: float, n: int, level: float) -> float:
    """At a mean of 0, delta in true standard errors: the mean over the sample's standard error of P(|mean| < delta - t s)."""
    room = delta - float(student.ppf(level, n - 1)) * _errors(n)
    return float(np.mean(np.where(room > 0.0, 2.0 * ndtr(room) - 1.0, 0.0)))


@lru_cache
def _errors(n: int) -> Floats:
    """Quantiles of a sample's standard error over the true one."""
    steps = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    errors = np.sqrt(chi2.ppf(steps, n - 1) / (n - 1))
    errors.flags.writeable = False
    return np.asarray(errors)
