"""Is d' below a Delta set beforehand? "Cannot tell apart" is a claim of its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.rules import Rule, RuleName, TaskName
from burrlab.psychophysics.statistics.conditional_hits import Integers, conditional_hits
from burrlab.psychophysics.statistics.group_d_prime import GRID, Group, check_level
from burrlab.psychophysics.statistics.group_tails import rejected_as_few
from burrlab.psychophysics.statistics.observer import EXPERIMENTS, SEED
from burrlab.psychophysics.statistics.subject_tests import probability_text

WANTED_POWER = 0.8

_BELOW_CHANCE = 0.01


@dataclass(frozen=True)
class Equivalence:
    """The outcome of a one-sided test of d' >= Delta.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    rule : {"independent-observations", "differencing"}
    delta, level : float
    subjects, informative : int
        All, and those who gave both answers: the others say nothing of d'.
    trials : tuple of int
        Fewest and most of a subject.
    upper : float
        The group's one-sided upper bound of d' at this level; inf where there is none.
    p_value : float
        Of so low a score if d' were Delta or more.
    p_below_chance : float
        Of so low a score at d' = 0: no d' explains a small one.
    equivalent : bool
        Whether d' >= Delta is rejected.
    power : float
        Probability of that at d' = 0, with these subjects, trials and numbers of answers.
    decidable_delta : float
        The smallest Delta that would have a power of 80 %; inf where none has.
    """

    task: TaskName
    rule: RuleName
    delta: float
    level: float
    subjects: int
    informative: int
    trials: tuple[int, int]
    upper: float
    p_value: float
    p_below_chance: float
    equivalent: bool
    power: float
    decidable_delta: float

    @property
    def sentence(self) -> str:
        """The outcome in plain words."""
        p = probability_text(self.p_value)
        if not self.informative:
            return (
                f"Not decided: no subject gave both answers, so nothing is known of d' ({self.rule}), "
                "though the score is at chance."
            )
        bound = "there is no upper bound" if math.isinf(self.upper) else f"upper bound {self.upper:.2f}"
        where = f"d' ({self.rule}), {bound} at {100 * self.level:.4g} %, {p}"
        if self.equivalent:
            text = f"Equivalent: below {self.delta:g} in {where}."
        else:
            text = f"Not shown to be equivalent: {self.delta:g} or more is possible in {where}. That does not show a difference."
        if self.informative < self.subjects:
            text += f" {self.subjects - self.informative} of {self.subjects} subjects gave one answer only: nothing is known of theirs."
        if self.p_below_chance < _BELOW_CHANCE:
            text += f" Scores are below chance ({probability_text(self.p_below_chance)}), which no d' explains: were answers swapped?"
        return text

    @property
    def design_sentence(self) -> str:
        """What these subjects and trials could decide."""
        few, most = self.trials
        size = f"{self.subjects} subject{'s' if self.subjects > 1 else ''} x {few if few == most else f'{few} to {most}'} trials"
        return decision_text(size, self.delta, self.power, self.decidable_delta)

    def __str__(self) -> str:
        return f"{self.sentence}\n{self.design_sentence}"

    def to_dict(self) -> dict[str, Any]:
        """For JSON; null for inf."""
        out = asdict(self)
        for name in ("upper", "decidable_delta"):
            out[name] = out[name] if math.isfinite(out[name]) else None
        return out | {"sentence": self.sentence, "design_sentence": self.design_sentence}


def equivalence(counts: Sequence[Counts], *, rule: str, delta: float, level: float = 0.95) -> Equivalence:
    """Whether a group's d' is below Delta, one-sided.

    The test is that of `group_d_prime`: a subject's hits are compared with those of an observer with d' = Delta who gives the answer as often.
    Who always says "same" has a score at chance whatever his d', and counts for nothing here.

    Parameters
    ----------
    counts : sequence of Counts
        One a subject, of one task; one subject is enough.
    rule : {"independent-observations", "differencing"}
    delta : float
        Set before the first answer, > 0.
    level : float, optional
        1 - the error rate.

    Raises
    ------
    ValueError
        If there is no subject, the tasks differ, the rule is unknown, Delta is not a number above 0, or the level is not in [0.5, 1).

    Notes
    -----
    With one subject the exact conditional test decides alone. The power is simulated with a fixed seed: the subjects' own numbers of answers, their
    hits by guessing (hypergeometric). A lapse looks like a smaller d': equivalence is of what the subjects did.

    References
    ----------
    Schuirmann, J. Pharmacokinet. Biopharm. 15, 657 (1987), for two one-sided tests, of which this is one.

    Examples
    --------
    >>> guessing = [Counts("same-different", 2, 6, 2, 6), Counts("same-different", 1, 6, 2, 6), Counts("same-different", 3, 6, 2, 6)]
    >>> print(equivalence(guessing * 4, rule="independent-observations", delta=1.5).sentence)
    Equivalent: below 1.5 in d' (independent-observations), upper bound 1.02 at 95 %, p = 0.00024.
    """
    check_level(level)
    if not 0.0 < delta < math.inf:
        raise ValueError(f"delta must be a number above 0, got {delta}")
    group = Group(counts, rule)
    error = 1.0 - level
    # The least favourable d' at Delta or above; the p value falls with d' but for the scatter in t.
    p_value = max(group.few(d) for d in (delta, *(d for d in GRID if d > delta)))
    sizes = [c.trials for c in counts]
    hits = guessed_hits(group)
    power, decidable = equivalence_power(
        group.decision, hits, group.answers, group.sizes, delta=delta, error=error
    )
    return Equivalence(
        task=group.decision.task,
        rule=group.decision.name,
        delta=float(delta),
        level=level,
        subjects=len(counts),
        informative=group.informative,
        trials=(min(sizes), max(sizes)),
        upper=group.upper(error),
        p_value=p_value,
        p_below_chance=group.few(0.0),
        equivalent=p_value <= error,
        power=power,
        decidable_delta=decidable,
    )


def guessed_hits(group: Group) -> Integers:
    """Of subjects with d' = 0 who give as many answers as these did, shape (experiments, subjects)."""
    rng = np.random.default_rng(SEED)
    columns = [
        rng.hypergeometric(signals, noises, int(answers), EXPERIMENTS) if signals * noises else None
        for (signals, noises), answers in zip(group.sizes, group.answers[0], strict=True)
    ]
    own = [np.full(EXPERIMENTS, h) for h in group.hits[0]]
    return np.stack([o if c is None else c for c, o in zip(columns, own, strict=True)], axis=1)


def equivalence_power(
    decision: Rule,
    hits: Integers,
    answers: Integers,
    sizes: Sequence[tuple[int, int]],
    *,
    delta: float,
    error: float,
) -> tuple[float, float]:
    """Share of simulated experiments that reject d' >= Delta, and the smallest Delta rejected by 80 % of them."""

    def power(d_prime: float) -> float:
        return share_below(decision, hits, answers, sizes, d_prime, error)

    if power(math.inf) < WANTED_POWER:
        return power(delta), math.inf
    low, high = 0.0, 20.0
    while high - low > 0.005:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if power(middle) >= WANTED_POWER else (middle, high)
    return power(delta), high


def share_below(
    decision: Rule,
    hits: Integers,
    answers: Integers,
    sizes: Sequence[tuple[int, int]],
    d_prime: float,
    error: float,
) -> float:
    """Share of simulated experiments that reject this d' as too high."""
    subjects = [conditional_hits(decision.task, decision.name, d_prime, *size) for size in sizes]
    return float(np.mean(rejected_as_few(hits, answers, subjects, error)))


def decision_text(size: str, delta: float, power: float, decidable: float, *, quantity: str = "d'") -> str:
    """What a design could decide, in one sentence."""
    smallest = "no Delta has 80 %" if math.isinf(decidable) else f"80 % begin at Delta = {decidable:.3g}"
    if power >= WANTED_POWER:
        return f"{size} would decide Delta = {delta:g} with a power of {100 * power:.0f} % if {quantity} were 0; {smallest}."
    return f"{size} cannot be relied on to decide Delta = {delta:g}: the power is {100 * power:.0f} % if {quantity} were 0; {smallest}."
