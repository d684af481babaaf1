"""Simulated subjects: rehearsals, predicted scores, the paper's Task 1, and a seat in a run."""

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from burrlab._core import Burr, Material
from burrlab.bone.materials import materials
from burrlab.common.check import refuse
from burrlab.psychophysics.designs import (
    ABX,
    MODES,
    ComparisonDesign,
    Draws,
    Interval,
    Mode,
    Order,
    TaskDesign,
    Trial,
    rendered,
)
from burrlab.psychophysics.interval import Block, Rendered
from burrlab.psychophysics.observer import (
    CUES,
    CUES_OF,
    DECISIONS,
    CueName,
    Cues,
    Decision,
    SimulatedSubject,
    closed_form_cues,
    interval_cues,
    rendered_cues,
)
from burrlab.psychophysics.power import DesignPower, Observer, design_power
from burrlab.psychophysics.psychometric import proportion_correct
from burrlab.psychophysics.rules import LAPSE, Counts, RuleName, TaskName, counts_of, one_of, rule_of
from burrlab.psychophysics.run import Seat
from burrlab.psychophysics.weber import COMPLIANCE_WITHOUT_SURFACE

REPLICATES = 3  # erosion seeds for each drilled material; probing erodes nothing and needs one
SELF_PACED = 10.0  # length of a simulated interval that the subject would end [s]; ours


def rehearse(
    design: TaskDesign,
    subject: SimulatedSubject,
    *,
    subjects: int = 20,
    seed: int,
    burr: Burr | None = None,
    bone: Block | None = None,
) -> list[Counts]:
    """The counts of equal simulated subjects, from one seed.

    Parameters
    ----------
    design : TaskDesign
        Each subject gets its own order. The matching material stands in for a real specimen.
    subject : SimulatedSubject
        If not yet taught, the subject is taught by `teach`.
    subjects : int
    seed : int
        Seed of orders, noise and lapses.
    burr : Burr, optional
        Default R = 3 mm.
    bone : Block, optional
        Default `Block()`.

    Returns
    -------
    list of Counts
        One per subject, of the main phase.

    Raises
    ------
    ValueError
        If there is no subject, the design's intervals lack the subject's cues, or the design asks for
        stiffness in drilling, which gives no cue for it.

    Notes
    -----
    Each material is rendered once in probing, and with three seeds in drilling; an interval takes one of the
    three by its own seed. This includes the scatter of the erosion, a standard deviation of 0.0001 to 0.0002
    of the logarithm at 0.1 mm, which is negligible beside the noise. A rehearsal of 20 subjects takes
    seconds instead of an hour. `burrlab experiment run --simulated` renders every interval.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.psychophysics import SameDifferent, SimulatedSubject, Stimulus
    >>> soft, hard = (Stimulus(name, burrlab.materials[name]) for name in ("pvc", "bone"))
    >>> design = SameDifferent(soft, hard, mode="drilling", interval=1.0)
    >>> [counts.score for counts in rehearse(design, SimulatedSubject(0.3, cues=["sinking"]), subjects=2, seed=1)]
    [11, 12]
    """
    refuse(operator.index(subjects) < 1, f"subjects must be at least 1, got {subjects}")
    orders = (
        rehearsed_order(design, subject, name=f"{number:02d}", seed=seed, burr=burr, bone=bone)
        for number in range(1, subjects + 1)
    )
    return [
        counts_of(
            design.task,
            [(trial.trial_type, response, trial.correct) for trial, response in order.counted()],
        )
        for order in orders
    ]


def rehearsed_order(
    design: TaskDesign,
    subject: SimulatedSubject,
    *,
    name: str = "01",
    seed: int,
    burr: Burr | None = None,
    bone: Block | None = None,
) -> Order:
    """The order of one subject with all answers, for results such as a staircase's levels.

    Parameters and errors are those of `rehearse`; `name` is the subject's.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.psychophysics import ABX, SimulatedSubject, Stimulus
    >>> soft, hard = (Stimulus(name, burrlab.materials[name]) for name in ("pvc", "bone"))
    >>> design = ABX(soft, hard, mode="drilling", interval=1.0)
    >>> order = rehearsed_order(design, SimulatedSubject(0.3, cues=["sinking"]), seed=1)
    >>> [answer for _, answer in order.answered][:3]
    ['first', 'first', 'first']
    """
    check_rehearsable(design)
    burr, bone = burr or Burr(3.0), bone or Block()
    taught = subject if subject.known is not None else teach(subject, design, burr=burr, bone=bone)
    rng = np.random.default_rng([operator.index(seed), *name.encode()])
    order = design.order(seed=seed, subject=name)
    while (trial := order.next()) is not None:
        felt = [_felt(design, interval, burr, bone) for interval in trial.intervals]
        response = taught.respond(trial, _towards_boundary(design, trial, felt), rng)
        order.answer(response, lost=not all(cues.reached for cues in felt))
    return order


def _towards_boundary(design: TaskDesign, trial: Trial, felt: Sequence[Cues]) -> list[Cues]:
    """The cues, of which more change means a boundary as the trial has it."""
    slower = isinstance(design, ComparisonDesign) and trial.level and not design.sinks_faster(trial.level)
    return [replace(cues, change=-cues.change) if slower else cues for cues in felt]


def teach(
    subject: SimulatedSubject, design: TaskDesign, *, burr: Burr | None = None, bone: Block | None = None
) -> SimulatedSubject:
    """The same subject with knowledge of the design's two materials; unchanged for two-interval tasks.

    Raises
    ------
    ValueError
        If the design does not have two materials, or its intervals lack the subject's cues.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.psychophysics import SameDifferent, SimulatedSubject, Stimulus
    >>> soft, hard = (Stimulus(name, burrlab.materials[name]) for name in ("pvc", "bone"))
    >>> design = SameDifferent(soft, hard, mode="drilling", interval=1.0)
    >>> teach(SimulatedSubject(0.3, cues=["sinking"]), design).decision
    'differencing'
    """
    if design.task == "2ifc":
        return subject
    burr, bone = burr or Burr(3.0), bone or Block()
    intervals: dict[Material | None, Interval] = {}
    order = design.order(seed=0, subject="taught")
    while len(intervals) < 2 and (trial := order.next()) is not None:
        for interval in trial.intervals:
            intervals.setdefault(stood_in(design, interval).stimulus.material, interval)
        order.answer(design.answers[0])
    refuse(len(intervals) != 2, f"design must have two materials, got {len(intervals)}")
    return subject.taught(*(_felt(design, interval, burr, bone) for interval in intervals.values()))


def check_rehearsable(design: TaskDesign) -> None:
    """Raises ValueError for a design that asks for a cue that simulated subjects do not feel."""
    refuse(
        design.mode == "drilling" and getattr(design, "hold", "other") == "sinking speed",
        "design must not hold the sinking speed, the only cue that simulated subjects have by drilling",
    )


def stood_in(design: TaskDesign, interval: Interval) -> Interval:
    """The interval with the match in place of a real reference, and with a length if it has none."""
    real = interval.stimulus.material is None
    stimulus = design.matching if real and isinstance(design, ABX) else interval.stimulus
    return replace(interval, stimulus=stimulus, duration=interval.duration or SELF_PACED)


def _felt(design: TaskDesign, interval: Interval, burr: Burr, bone: Block) -> Cues:
    stand_in = stood_in(design, interval)
    assert stand_in.duration is not None
    seed = 1 if design.mode == "probing" else 1 + interval.seed % REPLICATES
    return rendered_cues(
        rendered("stimulus", stand_in.stimulus), design.mode, burr=burr, bone=bone, duration=stand_in.duration, seed=seed,
        boundary=interval.boundary,
    )  # fmt: skip


@dataclass(frozen=True)
class Prediction:
    """d' and score of a simulated subject, with the power to show them. Prints as two lines. Made by `predicted_d_prime`.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    mode : {"probing", "drilling"}
    rule : {"differencing", "independent-observations"}
        The subject's rule.
    differences : dict
        Difference of each cue's logarithm, a minus b.
    by_cue : dict
        d' of each cue alone.
    d_prime : float
        d' of all the subject's cues together.
    trials, subjects : int
        Trials per subject, and subjects.
    score : float
        Expected score of one subject.
    lapse : float
    power : DesignPower
        Power of one subject's binomial test, and of the t test of a group.
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

    def __str__(self) -> str:
        parts = ", ".join(
            f"{cue} {d:.2f} (ln ratio {self.differences[cue]:+.3f})" for cue, d in self.by_cue.items()
        )
        row = self.power.rows[0]
        group = "" if row.group is None else f", of {self.subjects} subjects {100 * row.group:.0f} %"
        return "\n".join([
            f"{self.task} by {self.mode}, {self.rule}: d' {self.d_prime:.2f}: {parts}",
            f"expected score {self.score:.1f} of {self.trials} ({100 * self.lapse:g} % lapses); power of one "
            f"subject {100 * row.subject:.0f} %{group}",
        ])  # fmt: skip


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
    """d' of a pair of materials for a simulated subject, with the expected score and its power.

    Parameters
    ----------
    a, b : Material
    mode : {"probing", "drilling"}
    subject : SimulatedSubject
        Earlier teaching is ignored.
    task : {"same-different", "abx", "2ifc"}
    trials, subjects : int
        Trials per subject, and subjects.
    duration : float
        Length of an interval [s].
    closed_form : bool
        Whether to take cues from `closed_form_cues` instead of rendering two intervals. The sinking speed is
        then the speed at one depth, not the depth after a time (docs/simulated_subject.md).
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
        If the mode is unknown or lacks a cue of the subject, the subject has its own criterion, the materials
        are alike, or `trials` or `subjects` is out of range.

    Examples
    --------
    >>> import burrlab
    >>> m, subject = burrlab.materials, SimulatedSubject(weber=0.36)
    >>> print(predicted_d_prime(m["bone"], m["pvc"], "probing", subject, closed_form=True))
    same-different by probing, differencing: d' 2.84: stiffness 2.84 (ln ratio +1.024)
    expected score 9.3 of 12 (2 % lapses); power of one subject 48 %
    """
    one_of("mode", mode, MODES)
    for cue in subject.cues:
        refuse(
            cue not in CUES_OF[mode],
            f"cues must be of the mode, {mode} has {', '.join(CUES_OF[mode])}, got {cue!r}",
        )
    refuse(
        subject.criterion is not None, f"criterion must be None for a prediction, got {subject.criterion!r}"
    )
    burr, bone = burr or Burr(3.0), bone or Block()
    pair = [
        closed_form_cues(material, burr=burr)
        if closed_form
        else rendered_cues(material, mode, burr=burr, bone=bone, duration=duration)
        for material in (a, b)
    ]
    taught = subject.taught(*pair)
    d_prime, rule = taught.d_prime, rule_of(task, subject.rule)
    return Prediction(
        task=task,
        mode=mode,
        rule=subject.rule,
        differences={cue: getattr(pair[0], cue) - getattr(pair[1], cue) for cue in subject.cues},
        by_cue={
            cue: 0.0 if math.isclose(*(getattr(felt, cue) for felt in pair)) else replace(taught, cues=(cue,)).d_prime
            for cue in subject.cues
        },
        d_prime=d_prime,
        trials=trials,
        subjects=subjects,
        score=trials * float(rule.proportion_correct(d_prime, lapse=subject.lapse)),
        lapse=subject.lapse,
        power=design_power(
            task, trials=trials, subjects=subjects, rules=(subject.rule,), d_primes=(d_prime,), lapse=subject.lapse
        ),
    )  # fmt: skip


PAIRS = (("bone", "pvc"), ("bone", "pettigrew"), ("pvc", "pettigrew"))
TRIALS = 12
SUBJECTS = 20

_Z = 1.959964  # for 95 %
_NAMES: dict[str, tuple[CueName, ...]] = {
    "probing stiffness": ("stiffness",), "probing force": ("force",), "sinking speed": ("sinking",), "all": CUES,
}  # fmt: skip
#: The paper's mean score for bone and PVC, in probing and in drilling, to compare with each cue.
_PUBLISHED_FOR = {cue: 9.3 if cue.startswith("probing") else 9.6 for cue in _NAMES}


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
        Expected score of 12.
    low, high : float
        Range of the mean score of 20 such subjects in 95 % of experiments.
    """

    cue: str
    pair: str
    decision: Decision
    noise: float
    d_prime: float
    score: float
    low: float
    high: float


@dataclass(frozen=True)
class TaskOneTable:
    """Expected scores of Task 1. Made by `task1_table`.

    Attributes
    ----------
    rows : tuple of TaskOneRow
    differences : dict
        pair -> cue -> difference of the logarithm between the two materials.
    noise_of_published : dict
        (cue, decision) -> noise at which the first pair, bone and PVC, gives the paper's mean: 9.3 for the
        probing cues, 9.6 for sinking speed and for all. None if no noise gives the mean.
    source : str
        Source of the differences.
    lapse : float
    """

    rows: tuple[TaskOneRow, ...]
    differences: dict[str, dict[str, float]]
    noise_of_published: dict[tuple[str, str], float | None]
    source: str
    lapse: float

    def row(self, cue: str, pair: str, decision: str, noise: float) -> TaskOneRow:
        """The row of these values; ValueError if there is none."""
        rows = [
            row for row in self.rows
            if (row.cue, row.pair, row.decision) == (cue, pair, decision) and math.isclose(row.noise, noise)
        ]  # fmt: skip
        refuse(not rows, f"the table has no row {cue}, {pair}, {decision}, {noise!r}")
        return rows[0]

    def __str__(self) -> str:
        noises = sorted({row.noise for row in self.rows})
        lines = [
            f"Score of {TRIALS}, differences {self.source}, lapse {self.lapse:g}; the mean of {SUBJECTS} "
            "subjects lies within +- the second number in 95 %"
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
            noise_text = "no noise" if noise is None else f"a noise of {100 * noise:.0f} %"
            lines.append(
                f"{cue}, {rule}: {noise_text} gives the paper's {_PUBLISHED_FOR[cue]} for bone and PVC"
            )
        return "\n".join(lines)


def task1_table(
    *,
    differences: Literal["rendered", "closed form"] = "rendered",
    noises: Sequence[float] = (0.07, 0.10, 0.15, 0.22, 0.36, 0.45, 0.70, 1.00),
    lapse: float = LAPSE,
    burr: Burr | None = None,
    bone: Block | None = None,
) -> TaskOneTable:
    """Expected scores of 12 of equal, unbiased observers.

    Parameters
    ----------
    differences : {"rendered", "closed form"}
        Source of the differences of the cues' logarithms: intervals rendered with the simulated hands, or
        `closed_form_cues`.
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
        If `differences` is another text, or a noise is not positive.

    Notes
    -----
    Scores are exact, without simulation: d' = difference/noise (for several cues, the root of the sum of
    squares), with the rates of `rule_of`. The range is that of the mean of 20 independent scores, each the
    sum of 6 + 6 answers. "all" combines cues that no interval of the paper has together, so it is an upper
    limit.

    Examples
    --------
    >>> table = task1_table(differences="closed form", noises=(0.1, 0.3))
    >>> print(str(table).splitlines()[3])
    probing stiffness bone-pvc              11.9 +- 0.2    10.0 +- 0.6
    """
    cue_differences = _differences(differences, burr or Burr(3.0), bone or Block())
    for noise in noises:
        refuse(not 0.0 < noise < math.inf, f"noises must be positive and finite, got {noise!r}")
    rows = [
        _row(name, pair, decision, noise, _distance(cue_differences[pair], cues), lapse)
        for name, cues in _NAMES.items()
        for pair in cue_differences
        for decision in DECISIONS
        for noise in noises
    ]
    first = next(iter(cue_differences))
    published: dict[tuple[str, str], float | None] = {
        (name, decision): noise_for_score(_PUBLISHED_FOR[name], _distance(cue_differences[first], cues), decision, lapse=lapse)
        for name, cues in _NAMES.items()
        for decision in DECISIONS
    }  # fmt: skip
    return TaskOneTable(tuple(rows), cue_differences, published, differences, lapse)


def noise_for_score(
    score: float, difference: float, decision: Decision, *, lapse: float = LAPSE
) -> float | None:
    """The noise that gives this expected score; None if an observer with lapses cannot reach the score.

    Parameters
    ----------
    score : float
        Score of 12.
    difference : float
        Difference of the cue's logarithm.
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
    return float(abs(difference) / scipy.optimize.brentq(excess, low, high))


def _differences(source: str, burr: Burr, bone: Block) -> dict[str, dict[str, float]]:
    one_of("differences", source, ("rendered", "closed form"))
    cues = {name: closed_form_cues(materials[name], burr=burr) for pair in PAIRS for name in pair}
    if source == "rendered":
        cues = {
            name: Cues(**{
                cue: getattr(rendered_cues(materials[name], mode, burr=burr, bone=bone), cue)
                for mode, cues_of_mode in CUES_OF.items() for cue in cues_of_mode
            })
            for name in cues
        }  # fmt: skip
    return {
        f"{a}-{b}": {cue: getattr(cues[a], cue) - getattr(cues[b], cue) for cue in CUES} for a, b in PAIRS
    }


def _distance(differences: Mapping[str, float], cues: Sequence[str]) -> float:
    return math.sqrt(sum(differences[cue] ** 2 for cue in cues))


def _row(cue: str, pair: str, decision: Decision, noise: float, distance: float, lapse: float) -> TaskOneRow:
    rule = rule_of("same-different", SimulatedSubject(1.0, decision=decision).rule)
    d_prime, half = distance / noise, 0.5 * TRIALS
    observer = Observer(rule, d_prime, TRIALS, lapse)
    hit, false_alarm = observer.hit, observer.false_alarm
    score = half * (hit + 1.0 - false_alarm)
    spread = math.sqrt(half * (hit * (1.0 - hit) + false_alarm * (1.0 - false_alarm)) / SUBJECTS)
    return TaskOneRow(cue, pair, decision, noise, d_prime, score, score - _Z * spread, score + _Z * spread)


def default_subject(
    mode: Mode, *, weber: float = COMPLIANCE_WITHOUT_SURFACE, decision: Decision = "differencing", boundary: bool = False
) -> SimulatedSubject:  # fmt: skip
    """A subject who feels stiffness in probing; in drilling sinking speed, or its change with a boundary.

    For speeds and their changes no fraction is published.
    """
    return SimulatedSubject(weber=weber, cues=[CUES_OF[mode][boundary]], decision=decision)


class SimulatedSeat(Seat):
    """The seat of a simulated subject, who feels the cues of each rendered interval and answers by a rule.

    Parameters
    ----------
    subject : SimulatedSubject
        Learns the two materials of a same-different or ABX task first.
    design : TaskDesign
    burr : Burr
    bone : Block
    seed : int
        Seed of the experiment.
    name : str
        The subject's name; with seed, design and trial it determines the answer.
    on_progress : callable, optional
        Called with the progress line of each trial.

    Notes
    -----
    The match stands in for a real specimen.
    """

    wall_clock = False
    simulated = True

    def __init__(
        self, subject: SimulatedSubject, design: TaskDesign, *, burr: Burr, bone: Block, seed: int, name: str,
        on_progress: Callable[[str], object] | None = None,
    ) -> None:  # fmt: skip
        self._on_progress = on_progress or (lambda text: None)
        check_rehearsable(design)
        self._seed, self._name, self._design = seed, name, design
        self._subject = teach(subject, design, burr=burr, bone=bone)

    def stand_in(self, interval: Interval) -> Interval:
        return stood_in(self._design, interval)

    def ask(
        self, design: TaskDesign, trial: Trial, rendered: Sequence[Rendered | None]
    ) -> tuple[str, float | None]:
        cues = [Cues() if interval is None else interval_cues(interval) for interval in rendered]
        rng = _rng(self._seed, self._name, design, trial)
        return self._subject.respond(trial, _towards_boundary(design, trial, cues), rng), None

    def progress(self, text: str) -> None:
        self._on_progress(text)


class PsychometricSeat(Seat):
    """The seat of an observer of two-interval tasks whose psychometric function is set.

    It shows whether an experiment and its analysis give back what was put in, such as a slope along references.

    Parameters
    ----------
    threshold : callable
        From a reference's parameter [N/mm^2 or 1/ms] to |ln level| at 75 % correct.
    slope : float
        Exponent of the Weibull function of |ln level|; 1.25 is as Gaussian noise.
    lapse : float
        Share of random answers.
    seed : int
    name : str
        With seed, design and trial it determines the answer.

    Examples
    --------
    >>> seat = PsychometricSeat(lambda p0: 0.2 * (p0 / 2.0) ** 0.5, seed=1, name="01")
    >>> Sitting(protocol, "01", device="hand", simulated={"W": "0.2 (p0/2)^0.5"}, once=True).run(lambda task: seat)  # doctest: +SKIP
    """

    wall_clock = False
    simulated = True

    def __init__(
        self, threshold: Callable[[float], float], *, slope: float = 1.25, lapse: float = LAPSE, seed: int, name: str
    ) -> None:  # fmt: skip
        self._threshold, self._slope, self._lapse = threshold, slope, lapse
        self._seed, self._name = seed, name

    def ask(
        self, design: TaskDesign, trial: Trial, rendered: Sequence[Rendered | None]
    ) -> tuple[str, float | None]:
        if not isinstance(design, ComparisonDesign) or trial.level is None:
            raise ValueError("design must vary a parameter for an observer with a set psychometric function")
        threshold = self._threshold(getattr(design.reference.material, design.parameter))
        p = proportion_correct(abs(math.log(trial.level)), threshold, self._slope, self._lapse)
        (other,) = {*design.answers} - {trial.correct}
        return trial.correct if _rng(self._seed, self._name, design, trial).random() < p else other, None


def _rng(seed: int, name: str, design: TaskDesign, trial: Trial) -> np.random.Generator:
    """A simulated subject's draws in a trial, whenever it is asked."""
    what = {**design.to_dict(), "phase": trial.phase, "trial": trial.number}
    return np.random.default_rng(Draws(seed, name, {"simulated": what}).interval_seed())
