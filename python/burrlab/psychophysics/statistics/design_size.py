"""How many subjects, or trials, a power needs."""

from __future__ import annotations

from collections.abc import Callable

from burrlab.psychophysics.rules import Rule, rule_of
from burrlab.psychophysics.statistics.equivalence import WANTED_POWER, share_below
from burrlab.psychophysics.statistics.observer import Observer, critical_score
from burrlab.psychophysics.statistics.power import (
    check_d_prime,
    check_delta,
    check_design,
)


def subjects_needed(
    task: str,
    *,
    rule: str,
    trials: int,
    d_prime: float | None = None,
    delta: float | None = None,
    power: float = WANTED_POWER,
    level: float = 0.05,
    lapse: float = 0.02,
    most: int = 300,
) -> int | None:
    """The smallest group whose mean score is shown to be above chance, or whose d' to be below Delta.

    Parameters
    ----------
    task : {"same-different", "abx", "2ifc"}
    rule : {"independent-observations", "differencing"}
    trials : int
        Of each subject, even.
    d_prime : float, optional
        Of every subject: power of the t test on scores. Give this or `delta`.
    delta : float, optional
        Power of `equivalence` at d' = 0.
    power, level, lapse : float, optional
        `level` is the error rate of the test, one-sided.
    most : int, optional
        None is returned where not even so many are enough.

    Raises
    ------
    ValueError
        As for `design_power`; if not one of d_prime and delta is given; or power is not in (0, 1).

    Notes
    -----
    From two subjects on: what one can show, `trials_needed` says. The power is simulated as in `design_power`.

    Examples
    --------
    >>> subjects_needed("same-different", rule="differencing", trials=12, d_prime=1.5)
    11
    """
    decision = _checked(task, rule, d_prime, delta, power)
    check_design(trials, 2, level, lapse)
    return _least(
        lambda n: _group_power(decision, n, trials, d_prime, delta, level, lapse) >= power, 2, 1, most
    )


def trials_needed(
    task: str,
    *,
    rule: str,
    subjects: int = 1,
    d_prime: float | None = None,
    delta: float | None = None,
    power: float = WANTED_POWER,
    level: float = 0.05,
    lapse: float = 0.02,
    most: int = 1000,
) -> int | None:
    """The fewest trials of each subject; of one, for the exact binomial test, or for equivalence.

    Same-different trials are multiples of 4 (the pair types), others even.

    Parameters
    ----------
    task, rule, d_prime, delta, power, level, lapse, most
        As for `subjects_needed`; `most` is of trials.
    subjects : int, optional

    Raises
    ------
    ValueError
        As for `subjects_needed`.

    Notes
    -----
    The power of a binomial test rises and falls with each trial: the number is that from which on it stays, up to `most`.

    Examples
    --------
    >>> trials_needed("same-different", rule="differencing", d_prime=2.0)
    56
    """
    decision = _checked(task, rule, d_prime, delta, power)
    check_design(2, subjects, level, lapse)
    step = 4 if task == "same-different" else 2
    if subjects == 1 and d_prime is not None:
        enough = None
        for trials in range(most // step * step, 0, -step):
            observer = Observer(decision, d_prime, trials, lapse)
            if observer.from_score(critical_score(trials, level)[0]) < power:
                break
            enough = trials
        return enough
    return _least(
        lambda trials: _group_power(decision, subjects, trials, d_prime, delta, level, lapse) >= power,
        step,
        step,
        most,
    )


def _group_power(
    decision: Rule,
    subjects: int,
    trials: int,
    d_prime: float | None,
    delta: float | None,
    level: float,
    lapse: float,
) -> float:
    if delta is None:
        return Observer(decision, d_prime or 0.0, trials, lapse).group(subjects, level)
    hits, answers = Observer(decision, 0.0, trials, lapse).answers(subjects)
    sizes = [(trials // 2, trials // 2)] * subjects
    return share_below(decision, hits, answers, sizes, delta, level)


def _least(enough: Callable[[int], bool], first: int, step: int, most: int) -> int | None:
    """The least number from which `enough` holds, if it holds from there on: by doubling and halving."""
    low, high = first - step, first
    while not enough(high):
        low, high = high, 2 * high
        if low >= most:
            return None
    while high - low > step:
        middle = low + (high - low) // (2 * step) * step
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high if high <= most else None


def _checked(task: str, rule: str, d_prime: float | None, delta: float | None, power: float) -> Rule:
    if (d_prime is None) == (delta is None):
        raise ValueError(f"d_prime or delta must be given, not both, got {d_prime} and {delta}")
    if not 0.0 < power < 1.0:
        raise ValueError(f"power must be in (0, 1), got {power}")
    if d_prime is not None:
        check_d_prime("d_prime", d_prime)
    if delta is not None:
        check_delta(delta)
    return rule_of(task, rule)
