"""What a simulated subject would make of two materials, before anybody has rendered a trial."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from burrlab._core import Burr, Material
from burrlab.psychophysics.experiment.block import Block
from burrlab.psychophysics.rules import RuleName, TaskName, rule_of
from burrlab.psychophysics.simulation.cues import CUES_OF, CueName, Cues, closed_form_cues, rendered_cues
from burrlab.psychophysics.simulation.simulated_subject import SimulatedSubject
from burrlab.psychophysics.trial import MODES, Mode

if TYPE_CHECKING:
    from burrlab.psychophysics.statistics.power import DesignPower


@dataclass(frozen=True)
class Prediction:
    """d' and score of a simulated subject, and what it takes to show them. Prints as a few lines.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    mode : {"probing", "drilling"}
    rule : {"differencing", "independent-observations"}
        The subject's.
    differences : dict
        Of each cue's logarithm, a minus b.
    by_cue : dict
        d' of each cue alone.
    d_prime : float
        Of all of the subject's cues together.
    trials, subjects : int
        Of the experiment; trials of each subject.
    score : float
        Expected of one subject.
    lapse : float
    power : DesignPower
        Of one subject's binomial test, and of the group's t test where there is more than one.
    trials_needed, subjects_needed : int or None
        For 80 % power: trials of a single subject; subjects of so many trials each. None where no reasonable number does.
    """

    task: TaskName
    mode: Mode
    rule: RuleName
    differences: dict[CueName, float]
    by_cue: dict[CueName, float]
    d_prime: float
    trials: int
    subjects: int
    score: float
    lapse: float
    power: DesignPower
    trials_needed: int | None
    subjects_needed: int | None

    def __str__(self) -> str:
        parts = ", ".join(
            f"{cue} {d:.2f} (ln ratio {self.differences[cue]:+.3f})" for cue, d in self.by_cue.items()
        )
        needed = [
            f"{'no reasonable number' if number is None else number} {what}"
            for number, what in (
                (self.trials_needed, "trials of one subject"),
                (self.subjects_needed, f"subjects of {self.trials} trials"),
            )
        ]
        row = self.power.rows[0]
        group = "" if row.group is None else f", of {self.subjects} subjects {100 * row.group:.0f} %"
        return "\n".join([
            f"{self.task} by {self.mode}, {self.rule}: d' {self.d_prime:.2f}: {parts}",
            f"expected score {self.score:.1f} of {self.trials} ({100 * self.lapse:g} % lapses); power of one subject {100 * row.subject:.0f} %{group}",
            f"80 % power needs {needed[0]}, or {needed[1]}",
        ])  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**vars(self), "power": self.power.to_dict()}


def predicted_d_prime(
    a: Material,
    b: Material,
    mode: Mode,
    subject: SimulatedSubject,
    *,
    task: TaskName = "same-different",
    trials: int = 12,
    subjects: int = 1,
    duration: float = 20.0,
    closed_form: bool = False,
    burr: Burr | None = None,
    bone: Block | None = None,
) -> Prediction:
    """d' of a pair of materials for a simulated subject, with the score and the size of the experiment that follow.

    Parameters
    ----------
    a, b : Material
    mode : {"probing", "drilling"}
    subject : SimulatedSubject
        What it was taught before does not matter.
    task : {"same-different", "abx", "2ifc"}
    trials, subjects : int
        Of the experiment; trials of each subject.
    duration : float
        Of an interval [s].
    closed_form : bool
        Take cues from `closed_form_cues` instead of rendering two intervals. For the sinking speed that is another
        thing: the speed at one depth, not the depth after a time (docs/simulated_subject.md).
    burr : Burr, optional
        Default R = 3 mm.
    bone : Block, optional
        Default `Block()`.

    Returns
    -------
    Prediction

    Raises
    ------
    ValueError
        If the mode is unknown or does not have the subject's cues, the subject has a criterion of its own, the materials
        are alike, or `trials` or `subjects` is out of range.

    Examples
    --------
    >>> import burrlab
    >>> m, subject = burrlab.materials, SimulatedSubject(weber=0.36)
    >>> print(predicted_d_prime(m["bone"], m["pvc"], "probing", subject, closed_form=True))
    same-different by probing, differencing: d' 2.84: stiffness 2.84 (ln ratio +1.024)
    expected score 9.3 of 12 (2 % lapses); power of one subject 48 %
    80 % power needs 24 trials of one subject, or 4 subjects of 12 trials
    """
    from burrlab.psychophysics.statistics.design_size import subjects_needed, trials_needed
    from burrlab.psychophysics.statistics.power import design_power

    if mode not in MODES:
        raise ValueError(f"mode must be one of {', '.join(MODES)}, got {mode!r}")
    for cue in subject.cues:
        if cue not in CUES_OF[mode]:
            raise ValueError(f"cues must be of the mode, {mode} has {', '.join(CUES_OF[mode])}, got {cue!r}")
    if subject.criterion is not None:
        raise ValueError(f"criterion must be None for a prediction, got {subject.criterion!r}")
    burr, bone = burr or Burr(3.0), bone or Block()

    def felt(material: Material) -> Cues:
        if closed_form:
            return closed_form_cues(material, burr=burr)
        return rendered_cues(material, mode, burr=burr, bone=bone, duration=duration)

    pair = felt(a), felt(b)
    taught = subject.taught(*pair)
    d_prime, rule = taught.d_prime, rule_of(task, subject.rule)
    settings: dict[str, Any] = {"rule": subject.rule, "d_prime": d_prime, "lapse": subject.lapse}
    return Prediction(
        task=task,
        mode=mode,
        rule=subject.rule,
        differences={cue: getattr(pair[0], cue) - getattr(pair[1], cue) for cue in subject.cues},
        by_cue={cue: _alone(taught, cue) for cue in subject.cues},
        d_prime=d_prime,
        trials=trials,
        subjects=subjects,
        score=trials * float(rule.proportion_correct(d_prime, lapse=subject.lapse)),
        lapse=subject.lapse,
        power=design_power(
            task, trials=trials, subjects=subjects, rules=(subject.rule,), d_primes=(d_prime,), lapse=subject.lapse
        ),
        trials_needed=trials_needed(task, **settings),
        subjects_needed=subjects_needed(task, trials=trials, **settings),
    )  # fmt: skip


def _alone(subject: SimulatedSubject, cue: CueName) -> float:
    assert subject.known is not None
    a, b = (getattr(cues, cue) for cues in subject.known)
    return 0.0 if math.isclose(a, b) else replace(subject, cues=(cue,)).d_prime
