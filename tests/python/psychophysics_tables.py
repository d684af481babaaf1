"""Figures of docs/psychophysics.md and of docstrings that take minutes of simulation.

`PYTHONPATH=tests:tests/python python tests/python/psychophysics_tables.py NAME`, a name of `TABLES`; without one all are printed.
"""

from __future__ import annotations

import math
import sys

import numpy as np
from group_scenes import (
    FEW_CAN_TELL,
    SAME_D_PRIME,
    SEVERAL_D_PRIMES,
    rejections,
    rejections_of_several,
)

from burrlab.psychophysics.group import conditional_hits, group_tails
from burrlab.psychophysics.power import design_power
from burrlab.psychophysics.psychometric import psychometric_function
from burrlab.psychophysics.published import unbiased_d_prime
from burrlab.psychophysics.rules import RULES, rule_of
from burrlab.psychophysics.staircase import gaussian_correct
from reference import psychophysics as reference

EXPERIMENTS = 10_000
SIZES = ((12, 12), (20, 12), (12, 48), (20, 48))
DECISIONS = [(task, rule) for task in ("same-different", "abx") for rule in RULES]


def of_experiments(pairs) -> str:
    """The larger share of either side [%]."""
    few, many = np.max(np.array(pairs), axis=0) * 100 / EXPERIMENTS
    return f"{few:.1f} / {many:.1f}"


def group_errors() -> None:
    """A true d' rejected as too high / too low, the worst of tasks, rules and d' 0 to 3."""
    for subjects, trials in SIZES:
        size = {"subjects": subjects, "trials": trials, "experiments": EXPERIMENTS}
        cells = [
            of_experiments([
                rejections(task, rule, d, scene, **size)
                for task, rule in DECISIONS
                for d in (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
            ])
            for scene in SAME_D_PRIME.values()
        ]  # fmt: skip
        cells += [
            of_experiments([rejections_of_several(task, rule, scene, **size) for task, rule in DECISIONS])
            for scene in SEVERAL_D_PRIMES.values()
        ]
        print(f"| {subjects} x {trials} | " + " | ".join(cells) + " |", flush=True)


def few_can_tell() -> None:
    """The limit: few who can tell, same-different, either rule; and its mirror image, two intervals with d' 1.5 +- 0.75."""
    for subjects, trials in SIZES:
        size = {"subjects": subjects, "trials": trials, "experiments": EXPERIMENTS}
        cells = [
            of_experiments([rejections_of_several("same-different", rule, scene, **size) for rule in RULES])
            for scene in FEW_CAN_TELL.values()
        ]
        cells.append(
            of_experiments([rejections_of_several("2ifc", RULES[0], SEVERAL_D_PRIMES["spread"], **size)])
        )
        print(f"| {subjects} x {trials} | " + " | ".join(cells) + " |", flush=True)


def of_rates(task, rule, d_prime, rates, subjects, trials, rng):
    """Errors of subjects who draw one of these pairs of rates each."""
    drawn = np.asarray(rates)[rng.integers(0, len(rates), (EXPERIMENTS, subjects))]
    hits = rng.binomial(trials // 2, drawn[..., 0])
    answers = hits + rng.binomial(trials // 2, drawn[..., 1])
    subject = conditional_hits(task, rule, d_prime, trials // 2, trials // 2)
    few, many = group_tails(hits, answers, [subject] * subjects)
    return np.sum(few <= 0.05), np.sum(many <= 0.05)


def likelihood_observers() -> None:
    """Independent observations in same-different with real biases of the log likelihood ratio; the worst of d' 0.5 to 3."""
    rng = np.random.default_rng(4)
    for subjects, trials in SIZES:
        cells = []
        for biases in (np.linspace(-1.0, 1.0, 9), [0.5], [1.0]):
            pairs = []
            for d in (0.5, 1.0, 1.5, 2.0, 3.0):
                rates = [reference.same_different_likelihood(d, b) for b in biases]
                pairs.append(of_rates("same-different", RULES[0], d, rates, subjects, trials, rng))
            cells.append(of_experiments(pairs))
        print(f"| {subjects} x {trials} | " + " | ".join(cells) + " |", flush=True)


def lapses() -> None:
    """2 % lapses, unbiased: the d' without them rejected as too high, at d' 1, 1.5, 2, 3 by either rule."""
    rng = np.random.default_rng(5)
    for rule in RULES:
        decision = rule_of("same-different", rule)
        for subjects, trials in SIZES:
            shares = []
            for d in (1.0, 1.5, 2.0, 3.0):
                rates = [[0.98 * float(rate) + 0.01 for rate in decision.rates(d)]]
                few, _ = of_rates("same-different", rule, d, rates, subjects, trials, rng)
                shares.append(f"{100 * few / EXPERIMENTS:.1f}")
            print(f"| {rule} | {subjects} x {trials} | " + " | ".join(shares) + " |", flush=True)


def unseen() -> None:
    """The share of perfect subjects of whom a group holds none in 5 %, and the d' of the mean score if the rest guess."""
    for subjects in (12, 20):
        share = 1.0 - 0.05 ** (1.0 / subjects)
        found = [f"{unbiased_d_prime('same-different', rule, 0.5 + 0.5 * share):.2f}" for rule in RULES]
        print(f"{subjects} subjects: {100 * share:.0f} %, {dict(zip(RULES, found, strict=True))}")


def powers() -> None:
    """Equivalence at d' = 0."""
    for subjects, trials in ((5, 12), (12, 12), (20, 12), (40, 12), (12, 48), (20, 48)):
        for delta in (1.0, 1.5):
            found = design_power("same-different", trials=trials, subjects=subjects, d_primes=(), delta=delta)
            print(str(found).split("\n", 2)[2], flush=True)


def psychometric() -> None:
    """Five levels about the threshold of a Gaussian observer, 2 % lapses: 120 fits each; minutes, and psignifit."""
    rng, threshold = np.random.default_rng(7), 0.2
    differences = threshold * np.geomspace(0.35, 2.6, 5)
    for trials in (20, 60):
        held, bounds, logs = 0, 0, []
        for _ in range(120):
            right = [int(rng.binomial(trials, gaussian_correct(x, threshold))) for x in differences]
            fit = psychometric_function(np.exp(differences).tolist(), right, [trials] * 5)
            low, high = (math.log(end) for end in fit.interval)
            held += low <= threshold <= high
            bounds += any(name == "threshold" for name, _ in fit.at_bounds)
            logs.append(math.log(math.log(fit.threshold) / threshold))
        print(
            f"{trials} a level: held in {held} of 120, an end by the prior in {bounds}, "
            f"bias {100 * np.mean(logs):+.0f} %, sd {100 * np.std(logs):.0f} %",
            flush=True,
        )


TABLES = (
    group_errors, few_can_tell, likelihood_observers, lapses, unseen, powers, psychometric,
)  # fmt: skip

if __name__ == "__main__":
    for table in TABLES:
        if table.__name__ in sys.argv[1:] or not sys.argv[1:]:
            print(f"\n{table.__name__}: {table.__doc__}\n", flush=True)
            table()
