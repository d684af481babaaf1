"""The quality of estimates and intervals of d': every outcome of an experiment, weighted by its probability.

`python tests/reference/enumeration.py` prints the tables that `docs/psychophysics.md` sums up.
"""

import itertools
import sys
from collections.abc import Callable, Sequence
from types import SimpleNamespace

import numpy as np
from scipy.special import chdtri, ndtri

from burrlab.psychophysics.rules import RULES, Floats, Rule, rule_of
from burrlab.psychophysics.sensitivity import _TIE, LARGEST, Outcomes, _probabilities, binomial

D_PRIMES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)


def exact_p_values(rule: Rule, signals: int, noises: int, d_prime: float) -> Floats:
    """p-values of d' for every outcome, in the order of `Outcomes.all`.

    p(x) = max over the criterion of P(deviance(X) >= deviance(x) | d', criterion), X all outcomes.

    This is the likelihood-ratio test with its exact distribution at the worst criterion. For any criterion,
    the interval of the d' with p > 1 - level holds the truth at least as often as its level says.
    """
    deviance = Outcomes.all(signals, noises).deviance(rule, d_prime)
    of_hits, of_alarms = _probabilities(rule, signals, noises, d_prime)
    # from the least likely outcome to the likeliest
    order = np.argsort(-deviance)
    p = (of_hits[:, :, None] * of_alarms[:, None, :]).reshape(len(of_hits), -1)[:, order]
    beyond = np.cumsum(p, axis=1).max(axis=0)
    last = np.searchsorted(-deviance[order], _TIE - deviance, side="right") - 1
    return np.asarray(np.minimum(beyond[last], 1.0))


def outcome_probabilities(rule: Rule, trials: int, d_prime: float, criterion: float) -> Floats:
    """Probabilities of `Outcomes.all(trials/2, trials/2)`."""
    hit, miss, alarm, rejection = rule.log_rates(d_prime, criterion)
    half = trials // 2
    return np.asarray(np.outer(binomial(half, hit, miss), binomial(half, alarm, rejection)).ravel())


def enumerate_estimator(
    task: str,
    rule: str,
    *,
    trials: int,
    d_primes: Sequence[float] = D_PRIMES,
    shift: float = 0.0,
) -> list[SimpleNamespace]:
    """For each d' a row of shares of experiments and of biases of the mean, over all outcomes.

    Half of the trials are of either kind; `shift` is the criterion's, from the unbiased one [sd]. In a row:

    * exact, profile: the 95 % interval holds the truth; exact_open: it is open above;
    * wald: estimate +- standard errors exists and holds the truth;
    * infinite: estimates; bias: of finite estimates; bias_log_linear, bias_half: after a correction.
    """
    law, half = rule_of(task, rule), trials // 2
    outcomes = Outcomes.all(half, half)
    estimate, error = outcomes.estimate(law)[0], outcomes.standard_error(law)
    # Macmillan and Kaplan 1985: 1 - 1/(2n) and 1/(2n), only in place of 1 and 0
    clipped = [np.clip(rate, 0.5 / half, 1.0 - 0.5 / half) for rate in outcomes.rates]
    log_linear, by_half = (law.invert(*rates)[0] for rates in (outcomes.corrected(), clipped))
    finite, has_error = np.isfinite(estimate), np.isfinite(error)
    # An interval is open above if its test keeps the largest d'.
    exact_open = exact_p_values(law, half, half, LARGEST) > 0.05
    rows = []
    for d in d_primes:
        p = outcome_probabilities(law, trials, d, float(law.unbiased(d)) + shift)
        shares = {
            "exact": exact_p_values(law, half, half, d) > 0.05,
            "profile": outcomes.deviance(law, d) <= chdtri(1.0, 0.05),
            "exact_open": exact_open,
            "wald": has_error & (np.abs(np.where(has_error, estimate, 0.0) - d) <= ndtri(0.975) * error),
            "infinite": ~finite,
        }
        biases = {
            "bias": float(p[finite] @ estimate[finite] / p[finite].sum()) - d,
            "bias_log_linear": float(p @ log_linear) - d,
            "bias_half": float(p @ by_half) - d,
        }
        rows.append(SimpleNamespace(**{name: float(p @ held) for name, held in shares.items()}, **biases))
    return rows


def coverage_cell(row: SimpleNamespace) -> str:
    """Shares [%] of exact, profile and Wald intervals that hold the truth; * is mostly open."""
    shares = " / ".join(f"{100.0 * share:.1f}" for share in (row.exact, row.profile, row.wald))
    return shares + (" *" if row.exact_open > 0.5 else "")


def bias_cell(row: SimpleNamespace) -> str:
    """Bias of finite, log-linear and "half" estimates; share of infinite ones [%] in brackets."""
    biases = " / ".join(f"{bias:+.2f}" for bias in (row.bias, row.bias_log_linear, row.bias_half))
    return f"{biases} ({100.0 * row.infinite:.0f})"


def table(task: str, cell: Callable[[SimpleNamespace], str], shift: float = 0.0) -> str:
    """Markdown: a cell for each d' in rows of rules and trials, and an empty line."""
    lines = [
        "| rule | trials | " + " | ".join(f"d' {d:g}" for d in D_PRIMES) + " |",
        "|---|---|" + "---|" * len(D_PRIMES),
    ]
    for rule, trials in itertools.product(RULES, (12, 48, 200)):
        cells = map(cell, enumerate_estimator(task, rule, trials=trials, shift=shift))
        lines.append(f"| {rule} | {trials} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n\n"


if __name__ == "__main__":
    for task, shift in itertools.product(("same-different", "abx"), (0.0, 0.5)):
        sys.stdout.write(f"{task}, criterion {shift:g} from the unbiased one: exact / profile / Wald\n\n")
        sys.stdout.write(table(task, coverage_cell, shift))
    for task in ("same-different", "abx"):
        sys.stdout.write(f"{task}, bias: finite / log-linear / half (infinite)\n\n" + table(task, bias_cell))
