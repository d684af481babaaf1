"""What selection by the outcome does to a mean score: the best of many chance performers are above chance."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import stats


@dataclass(frozen=True)
class SelectionEffect:
    """Mean score of the best `kept` of `of` subjects who all answer at random.

    Parameters
    ----------
    kept, of : int
        Subjects selected; subjects they were selected from.
    trials : int
        That each of them answered.
    chance : float
        Probability of a correct answer in one.

    Raises
    ------
    ValueError
        If `kept` is below 1 or above `of`, there is no trial, or `chance` is not in (0, 1).
    TypeError
        If `kept`, `of` or `trials` is not whole.

    Notes
    -----
    Exact. With M_t subjects of the `of` at t or more correct answers, the sum of the best `kept` is the sum over t >= 1 of
    min(kept, M_t), and M_t is binomial.

    Examples
    --------
    >>> effect = SelectionEffect(kept=12, of=20, trials=12)
    >>> print(f"{effect.expected:.2f} of 12, {effect.excess:.2f} above chance")
    7.06 of 12, 1.06 above chance
    """

    kept: int
    of: int
    trials: int
    chance: float = 0.5

    def __post_init__(self) -> None:
        for name in ("kept", "of", "trials"):
            object.__setattr__(self, name, operator.index(getattr(self, name)))
        if not 1 <= self.kept <= self.of:
            raise ValueError(f"kept must be in 1..of, 1..{self.of}, got {self.kept}")
        if self.trials < 1:
            raise ValueError(f"trials must be at least 1, got {self.trials}")
        if not 0.0 < self.chance < 1.0:
            raise ValueError(f"chance must be in (0, 1), got {self.chance!r}")

    @property
    def expected(self) -> float:
        """Mean score of those selected."""
        reaching = stats.binom.sf(np.arange(self.trials), self.trials, self.chance)
        m = np.arange(self.of + 1)
        share = stats.binom.pmf(m, self.of, reaching[:, None])
        return float((share * np.minimum(m, self.kept)).sum() / self.kept)

    @property
    def excess(self) -> float:
        """`expected` over the score of chance: what selection alone adds."""
        return self.expected - self.chance * self.trials

    def p_value(self, mean: float) -> float:
        """Probability that chance performers so selected have at least this mean score."""
        # A mean that was a division lies a rounding off the sum it came from.
        total = int(np.ceil(mean * self.kept - 1e-9))
        return float(min(1.0, self.distribution[max(0, total) :].sum()))

    @cached_property
    def distribution(self) -> NDArray[np.float64]:
        """Probability of each sum of scores of those selected, 0..kept trials."""
        # Given the score t of the last one selected, a subjects lie above it, alike and independent, and kept - a have t.
        length = self.kept * self.trials + 1
        scores = np.arange(self.trials + 1)
        p = stats.binom.pmf(scores, self.trials, self.chance)
        turn = np.exp(-2j * np.pi * np.arange(length // 2 + 1) / length)
        above = np.arange(self.kept)
        spectrum = np.zeros(len(turn), dtype=np.complex128)
        for t in scores:
            tail = p[t + 1 :].sum()
            at_or_below = max(1.0 - tail, p[t])
            at_t = min(p[t] / at_or_below, 1.0)
            weight = stats.binom.pmf(above, self.of, tail)
            weight *= stats.binom.sf(self.kept - above - 1, self.of - above, at_t)
            higher = np.zeros(length)
            higher[t + 1 : self.trials + 1] = p[t + 1 :] / tail if tail > 0 else 0.0
            one = np.fft.rfft(higher)
            # Horner: sum over a of weight_a one^a turn^((kept - a) t)
            step = turn ** int(t)
            part = np.zeros_like(spectrum)
            for a in above[::-1]:
                part = part * one + weight[a] * step ** int(self.kept - a)
            spectrum += part
        return np.clip(np.fft.irfft(spectrum, length), 0.0, 1.0)
