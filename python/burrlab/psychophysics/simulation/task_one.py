"""The paper's Task 1 by simulated subjects: which cue, with how much noise, gives which score."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from burrlab._core import Burr
from burrlab.materials import materials
from burrlab.psychophysics.experiment.block import Block
from burrlab.psychophysics.rules import rule_of
from burrlab.psychophysics.simulation.cues import (
    CUES,
    CUES_OF,
    CueName,
    Cues,
    closed_form_cues,
    rendered_cues,
)
from burrlab.psychophysics.simulation.simulated_subject import DECISIONS, LAPSE, Decision, SimulatedSubject

NOISES = (0.07, 0.10, 0.15, 0.22, 0.36, 0.45, 0.70, 1.00)
PAIRS = (("bone", "pvc"), ("bone", "pettigrew"), ("pvc", "pettigrew"))
TRIALS = 12
SUBJECTS = 20
#: Mean scores that the paper gives for bone and PVC, by probing and by drilling.
PUBLISHED = {"probing": 9.3, "drilling": 9.6}

_Z = 1.959964  # of 95 %
_NAMES: dict[str, tuple[CueName, ...]] = {
    "probing stiffness": ("stiffness",), "probing force": ("force",), "sinking speed": ("sinking",), "all": CUES,
}  # fmt: skip


@dataclass(frozen=True)
class TaskOneRow:
    """One cell of the table.

    Attributes
    ----------
    cue, pair, decision : str
    noise : float
        Weber fraction of each cue.
    d_prime : float
    score : float
        Expected, of 12.
    low, high : float
        Where the mean score of 20 such subjects lies in 95 % of experiments.
    """

    cue: str
    pair: str
    decision: Decision
    noise: float
    d_prime: float
    score: float
    low: float
    high: float


@dataclass(frozen=True, repr=False)
class TaskOneTable:
    """Expected scores of Task 1; `to_dict` has it for JSON.

    Attributes
    ----------
    rows : tuple of TaskOneRow
    differences : dict
        pair -> cue -> difference of the logarithm between the two materials.
    noise_of_published : dict
        (cue, decision) -> the noise at which the first pair, bone and PVC, gives the paper's mean: 9.3 for the probing cues,
        9.6 for sinking speed and for all. None where no noise does.
    source : str
        Of the differences: "rendered" or "closed form".
    lapse : float
    """

    rows: tuple[TaskOneRow, ...]
    differences: dict[str, dict[str, float]]
    noise_of_published: dict[tuple[str, str], float | None]
    source: str
    lapse: float

    def row(self, cue: str, pair: str, decision: str, noise: float) -> TaskOneRow:
        """Raises ValueError if the table does not have it."""
        for row in self.rows:
            if (row.cue, row.pair, row.decision) == (cue, pair, decision) and math.isclose(row.noise, noise):
                return row
        raise ValueError(f"the table has no row {cue}, {pair}, {decision}, {noise!r}")

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "rows": [vars(row) for row in self.rows], "ln_differences": self.differences, "lapse": self.lapse,
            "noise_of_published": [
                {"cue": cue, "decision": decision, "noise": noise}
                for (cue, decision), noise in self.noise_of_published.items()
            ],
            "source": self.source, "trials": TRIALS, "subjects": SUBJECTS,
        }  # fmt: skip

    def __str__(self) -> str:
        noises = sorted({row.noise for row in self.rows})
        lines = [
            f"Score of {TRIALS}, differences {self.source}, lapse {self.lapse:g}; the mean of {SUBJECTS} subjects lies within +- the second number in 95 %"
        ]
        for decision in dict.fromkeys(row.decision for row in self.rows):
            lines += ["", f"{decision:<36}" + "".join(f"{100 * noise:>12.0f} %" for noise in noises)]
            for cue in dict.fromkeys(row.cue for row in self.rows):
                for pair in self.differences:
                    cells = [self.row(cue, pair, decision, noise) for noise in noises]
                    lines.append(
                        f"{cue:<18}{pair:<18}"
                        + "".join(f"{c.score:>8.1f} +- {0.5 * (c.high - c.low):.1f}" for c in cells)
                    )
        lines.append("")
        for (cue, rule), noise in self.noise_of_published.items():
            there = "no noise" if noise is None else f"a noise of {100 * noise:.0f} %"
            lines.append(f"{cue}, {rule}: {there} gives the paper's {_published(cue)} for bone and PVC")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"TaskOneTable({len(self.rows)} rows, differences {self.source})"


def task1_table(
    *,
    differences: str | Mapping[str, Mapping[str, float]] = "rendered",
    noises: Sequence[float] = NOISES,
    lapse: float = LAPSE,
    burr: Burr | None = None,
    bone: Block | None = None,
) -> TaskOneTable:
    """Scores of 12 that unbiased observers who differ in nothing but chance would have.

    Parameters
    ----------
    differences : {"rendered", "closed form"} or mapping
        Of the cues' logarithms: measured in intervals that the simulated hands felt, `closed_form_cues`, or
        pair -> cue -> value, a pair named as "bone-pvc".
    noises : sequence of float
        Weber fractions, each for every cue.
    lapse : float
    burr : Burr, optional
        Default R = 3 mm.
    bone : Block, optional
        Default `Block()`.

    Returns
    -------
    TaskOneTable

    Raises
    ------
    ValueError
        If `differences` is another string, or a noise is not positive.

    Notes
    -----
    Exact: d' = difference/noise (several cues: the root of the sum of squares) and the rates of `rule_of`, no simulation.
    The width is that of the mean of 20 independent scores, each the sum of 6 + 6 answers. "all" combines cues that no
    interval of the paper has together, and so is an upper limit.
    """
    found = _differences(differences, burr or Burr(3.0), bone or Block())
    for noise in noises:
        if not 0.0 < noise < math.inf:
            raise ValueError(f"noises must be positive and finite, got {noise!r}")
    rows = [
        _row(name, pair, decision, noise, _distance(found[pair], cues), lapse)
        for name, cues in _NAMES.items()
        for pair in found
        for decision in DECISIONS
        for noise in noises
    ]
    first = next(iter(found))
    published: dict[tuple[str, str], float | None] = {
        (name, decision): noise_for_score(_published(name), _distance(found[first], cues), decision, lapse=lapse)
        for name, cues in _NAMES.items()
        for decision in DECISIONS
    }  # fmt: skip
    source = differences if isinstance(differences, str) else "given"
    return TaskOneTable(tuple(rows), found, published, source, lapse)


def noise_for_score(
    score: float, difference: float, decision: Decision, *, lapse: float = LAPSE
) -> float | None:
    """The noise at which the expected score of 12 is this; None outside what an observer with lapses can have.

    Parameters
    ----------
    score : float
        Of 12.
    difference : float
        Of the cue's logarithm.
    decision : {"differencing", "covert"}
    lapse : float

    Returns
    -------
    float or None
    """
    rule = rule_of("same-different", SimulatedSubject(1.0, decision=decision).rule)

    def excess(d_prime: float) -> float:
        return TRIALS * float(rule.proportion_correct(d_prime, lapse=lapse)) - score

    low, high = 0.01, 50.0
    if difference == 0.0 or excess(low) >= 0.0 or excess(high) <= 0.0:
        return None
    return float(abs(difference) / brentq(excess, low, high))


def _differences(
    source: str | Mapping[str, Mapping[str, float]], burr: Burr, bone: Block
) -> dict[str, dict[str, float]]:
    if not isinstance(source, str):
        return {pair: dict(values) for pair, values in source.items()}
    names = sorted({name for pair in PAIRS for name in pair})
    if source == "closed form":
        cues = {name: closed_form_cues(materials[name], burr=burr) for name in names}
    elif source == "rendered":
        cues = {name: _rendered(name, burr, bone) for name in names}
    else:
        raise ValueError(f"differences must be 'rendered', 'closed form' or a mapping, got {source!r}")
    return {
        f"{a}-{b}": {cue: getattr(cues[a], cue) - getattr(cues[b], cue) for cue in CUES} for a, b in PAIRS
    }


def _rendered(name: str, burr: Burr, bone: Block) -> Cues:
    found = {
        cue: getattr(rendered_cues(materials[name], mode, burr=burr, bone=bone), cue)
        for mode, cues in CUES_OF.items()
        for cue in cues
    }
    return Cues(**found)


def _distance(differences: Mapping[str, float], cues: Sequence[str]) -> float:
    return math.sqrt(sum(differences[cue] ** 2 for cue in cues))


def _published(cue: str) -> float:
    return PUBLISHED["probing" if cue.startswith("probing") else "drilling"]


def _row(cue: str, pair: str, decision: Decision, noise: float, distance: float, lapse: float) -> TaskOneRow:
    rule = rule_of("same-different", SimulatedSubject(1.0, decision=decision).rule)
    d_prime = distance / noise
    rates = np.array([float(rate) for rate in rule.rates(d_prime)])
    hit, false_alarm = (1.0 - lapse) * rates + 0.5 * lapse
    half = 0.5 * TRIALS
    score = half * (hit + 1.0 - false_alarm)
    spread = math.sqrt(half * (hit * (1.0 - hit) + false_alarm * (1.0 - false_alarm)) / SUBJECTS)
    return TaskOneRow(cue, pair, decision, noise, d_prime, score, score - _Z * spread, score + _Z * spread)
