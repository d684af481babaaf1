"""Simulated numbers of docs/psychophysics.md and of docstrings; they take minutes.

`PYTHONPATH=tests:tests/python python tests/python/psychophysics_tables.py NAME` prints one of `TABLES`;
without NAME, all.
"""

import itertools
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

from burrlab.psychophysics import design_power, psychometric_function
from burrlab.psychophysics.group import conditional_hits, group_tails, unbiased_d_prime
from burrlab.psychophysics.rules import RULES, rule_of
from burrlab.psychophysics.staircase import gaussian_correct
from reference import psychophysics as reference

EXPERIMENTS = 10_000
SIZES = ((12, 12), (20, 12), (12, 48), (20, 48))
DECISIONS = [(task, rule) for task in ("same-different", "abx") for rule in RULES]


def table(*columns) -> None:
    """Prints a row for each size. A column gives pairs of errors; the largest of each side is printed [%]."""
    for subjects, trials in SIZES:
        size = {"subjects": subjects, "trials": trials, "experiments": EXPERIMENTS}
        shares = [np.max(np.array(pairs(size)), axis=0) * 100 / EXPERIMENTS for pairs in columns]
        cells = [f"{few:.1f} / {many:.1f}" for few, many in shares]
        print(f"| {subjects} x {trials} | " + " | ".join(cells) + " |", flush=True)


def several(scene, decisions):
    return lambda size: [rejections_of_several(*decision, scene, **size) for decision in decisions]


def group_errors() -> None:
    """How often a true d' is rejected as too high / too low; the worst of tasks, rules and d' 0 to 3."""

    def same(scene):
        cases = list(itertools.product(DECISIONS, (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)))
        return lambda size: [rejections(*decision, d, scene, **size) for decision, d in cases]

    table(*map(same, SAME_D_PRIME.values()), *(several(x, DECISIONS) for x in SEVERAL_D_PRIMES.values()))


def few_can_tell() -> None:
    """The limit: few can tell, same-different, either rule. Mirror image: two intervals, d' 1.5 +- 0.75."""
    scenes = [several(scene, DECISIONS[:2]) for scene in FEW_CAN_TELL.values()]
    table(*scenes, several(SEVERAL_D_PRIMES["spread"], [("2ifc", RULES[0])]))


def of_rates(rule, d_prime, rates, subjects, trials, rng):
    """Errors of groups whose subjects each draw one of these pairs of rates."""
    drawn = np.asarray(rates)[rng.integers(0, len(rates), (EXPERIMENTS, subjects))]
    hits = rng.binomial(trials // 2, drawn[..., 0])
    answers = hits + rng.binomial(trials // 2, drawn[..., 1])
    subject = conditional_hits("same-different", rule, d_prime, trials // 2, trials // 2)
    few, many = group_tails(hits, answers, [subject] * subjects)
    return np.sum(few <= 0.05), np.sum(many <= 0.05)


def likelihood_observers() -> None:
    """Same-different, independent observations, biases of the log likelihood ratio; worst of d' 0.5 to 3."""
    rng = np.random.default_rng(4)

    def biased(biases):
        rates = {
            d: [reference.same_different_likelihood(d, b) for b in biases] for d in (0.5, 1.0, 1.5, 2.0, 3.0)
        }
        return lambda size: [
            of_rates(RULES[0], d, x, size["subjects"], size["trials"], rng) for d, x in rates.items()
        ]

    table(*map(biased, (np.linspace(-1.0, 1.0, 9), [0.5], [1.0])))


def lapses() -> None:
    """2 % lapses, unbiased: how often the d' without lapses is rejected as too high, at d' 1, 1.5, 2, 3."""
    rng = np.random.default_rng(5)
    for rule, (subjects, trials) in itertools.product(RULES, SIZES):
        shares = []
        for d in (1.0, 1.5, 2.0, 3.0):
            rates = [[0.98 * float(rate) + 0.01 for rate in rule_of("same-different", rule).rates(d)]]
            few, _ = of_rates(rule, d, rates, subjects, trials, rng)
            shares.append(f"{100 * few / EXPERIMENTS:.1f}")
        print(f"| {rule} | {subjects} x {trials} | " + " | ".join(shares) + " |", flush=True)


def unseen() -> None:
    """The share of perfect people that 5 % of groups lack, and d' of the mean score if all others guess."""
    for subjects in (12, 20):
        share = 1.0 - 0.05 ** (1.0 / subjects)
        found = [f"{unbiased_d_prime('same-different', rule, 0.5 + 0.5 * share):.2f}" for rule in RULES]
        print(f"{subjects} subjects: {100 * share:.0f} %, {dict(zip(RULES, found, strict=True))}")


def powers() -> None:
    """Power of equivalence at d' = 0."""
    for (subjects, trials), delta in itertools.product(((5, 12), (40, 12), *SIZES), (1.0, 1.5)):
        found = design_power("same-different", trials=trials, subjects=subjects, d_primes=(), delta=delta)
        print(str(found).split("\n", 2)[2], flush=True)


def psychometric() -> None:
    """120 fits of a Gaussian observer with 2 % lapses at five levels about the threshold; needs psignifit."""
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
    for made in TABLES:
        if made.__name__ in sys.argv[1:] or not sys.argv[1:]:
            print(f"\n{made.__name__}: {made.__doc__}\n", flush=True)
            made()
