"""Tests that take the subject as the unit: t, and exact by exchanging signs or groups."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import t as student

from burrlab.psychophysics.rules import Floats

Side: TypeAlias = Literal["greater", "two-sided"]

_MOST_SUMS = 2**18


@dataclass(frozen=True)
class SubjectTest:
    """The outcome of a test.

    Attributes
    ----------
    name : str
    statistic : float or None
        t; None where there is none: an exact test, one subject, or no scatter.
    freedom : float or None
        Degrees of freedom of t.
    p_value : float or None
        None where the data allow no such test.
    side : {"greater", "two-sided"}
    """

    name: str
    statistic: float | None
    freedom: float | None
    p_value: float | None
    side: Side

    def __str__(self) -> str:
        if self.p_value is None:
            return f"{self.name}: not possible (one value, or no scatter)"
        p = probability_text(self.p_value)
        if self.statistic is None or self.freedom is None:
            return f"{self.name}: {p}"
        return f"{self.name}: t({self.freedom:.4g}) = {self.statistic:.2f}, {p}"

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def probability_text(p: float) -> str:
    """A p value as it is printed."""
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"


def t_test(values: ArrayLike, *, side: Side = "greater", name: str = "t test") -> SubjectTest:
    """Of a mean of 0."""
    x = finite_values(values)
    error = float(np.std(x, ddof=1)) / math.sqrt(len(x)) if len(x) > 1 else 0.0
    if error == 0.0:
        return SubjectTest(name, None, None, None, side)
    return _of_t(name, float(np.mean(x)) / error, len(x) - 1.0, side)


def welch_test(first: ArrayLike, second: ArrayLike, *, name: str = "Welch's t test") -> SubjectTest:
    """Of equal means of two groups, two-sided; the variances may differ (Welch, Biometrika 34, 28, 1947)."""
    x, y = finite_values(first), finite_values(second)
    if len(x) < 2 or len(y) < 2:
        return SubjectTest(name, None, None, None, "two-sided")
    a, b = float(np.var(x, ddof=1)) / len(x), float(np.var(y, ddof=1)) / len(y)
    if a + b == 0.0:
        return SubjectTest(name, None, None, None, "two-sided")
    freedom = (a + b) ** 2 / (a**2 / (len(x) - 1) + b**2 / (len(y) - 1))
    return _of_t(name, float(np.mean(x) - np.mean(y)) / math.sqrt(a + b), freedom, "two-sided")


def sign_flip_test(values: ArrayLike, *, side: Side = "greater", name: str = "sign-flip test") -> SubjectTest:
    """Exact test of values symmetric about 0: the share of all 2^n choices of signs whose sum is as large.

    Sums are counted, not listed, so that any number of subjects with whole or half values is exact; other values up to 18 subjects.

    Raises
    ------
    ValueError
        If there is no value, one is not finite, or the sums are too many to count.
    """
    x = finite_values(values)
    sums, chances = np.zeros(1), np.ones(1)
    for value in np.abs(x):
        ends = np.concatenate([sums - value, sums + value])
        sums, chances = _gathered(ends, np.tile(0.5 * chances, 2), "values")
    seen, slack = float(np.sum(x)), 1e-7 * max(1.0, float(np.sum(np.abs(x))))
    as_far = np.abs(sums) >= abs(seen) - slack if side == "two-sided" else sums >= seen - slack
    return SubjectTest(name, None, None, min(1.0, float(np.sum(chances[as_far]))), side)


def label_test(
    first: Sequence[float] | Floats,
    second: Sequence[float] | Floats,
    *,
    name: str = "permutation test",
) -> SubjectTest:
    """Exact two-sided test of two groups alike: the share of all divisions whose means differ as much.

    Raises
    ------
    ValueError
        If a group is empty, a value is not finite, or the sums are too many to count.
    """
    x, y = finite_values(first), finite_values(second)
    everyone, size = np.concatenate([x, y]), len(x)
    mean = float(np.mean(everyone))
    # Of k subjects chosen among those so far: the sums of their deviations, and how many choices have each.
    nothing = np.zeros(0)
    ways = [(np.zeros(1), np.ones(1))] + [(nothing, nothing)] * size
    for value in everyone - mean:
        for k in range(size, 0, -1):
            sums = np.concatenate([ways[k][0], ways[k - 1][0] + value])
            ways[k] = _gathered(sums, np.concatenate([ways[k][1], ways[k - 1][1]]), "groups")
    seen = abs(float(np.sum(x - mean)))
    slack = 1e-7 * max(1.0, float(np.sum(np.abs(everyone - mean))))
    sums, choices = ways[size]
    share = float(np.sum(choices[np.abs(sums) >= seen - slack])) / math.comb(len(everyone), size)
    return SubjectTest(name, None, None, min(1.0, share), "two-sided")


def _gathered(sums: Floats, weights: Floats, name: str) -> tuple[Floats, Floats]:
    """Equal sums as one."""
    kept, place = np.unique(np.round(sums, 9), return_inverse=True)
    if len(kept) > _MOST_SUMS:
        raise ValueError(f"{name} must have at most {_MOST_SUMS} different sums, got more")
    return kept, np.asarray(np.bincount(place.ravel(), weights, minlength=len(kept)), dtype=np.float64)


def _of_t(name: str, t: float, freedom: float, side: Side) -> SubjectTest:
    p = 2.0 * student.sf(abs(t), freedom) if side == "two-sided" else student.sf(t, freedom)
    return SubjectTest(name, t, freedom, float(p), side)


def finite_values(values: ArrayLike) -> Floats:
    """One row of numbers, or one sentence."""
    x = np.asarray(values, dtype=np.float64)
    if x.ndim != 1 or len(x) == 0:
        raise ValueError(f"values must be one row with at least one value, got shape {x.shape}")
    if not np.all(np.isfinite(x)):
        raise ValueError("values must be finite, got nan or infinity")
    return x
