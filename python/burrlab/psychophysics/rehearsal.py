"""Simulated subjects: rehearsals, predicted scores, and a seat in a run."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from burrlab._core import Burr, Material
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
    CUES_OF,
    CueName,
    Cues,
    SimulatedSubject,
    closed_form_cues,
    interval_cues,
    rendered_cues,
)
from burrlab.psychophysics.power import DesignPower, design_power
from burrlab.psychophysics.psychometric import proportion_correct
from burrlab.psychophysics.rules import LAPSE, Counts, TaskName, counts_of, one_of, whole
from burrlab.psychophysics.run import Seat

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
    whole("subjects", subjects, at_least=1)
    return [
        counts_of(
            design.task, [(trial.trial_type, response, trial.correct) for trial, response in order.counted()]
        )
        for number in range(1, subjects + 1)
        for order in [rehearsed_order(design, subject, name=f"{number:02d}", seed=seed, burr=burr, bone=bone)]
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
    order = design.order(seed=seed, subject=name)
    rng = np.random.default_rng([seed, *name.encode()])
    while (trial := order.next()) is not None:
        felt = [_felt(design, interval, burr, bone) for interval in trial.intervals]
        response = taught.respond(design.task, _towards_boundary(design, trial, felt), rng)
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
    """d' of a simulated subject, with the score and the power that follow. Prints as two lines. Made by `predicted_d_prime`.

    Attributes
    ----------
    mode : {"probing", "drilling"}
    differences : dict
        Difference of each cue's logarithm, a minus b.
    by_cue : dict
        d' of each cue alone.
    d_prime : float
        d' of all the subject's cues together.
    power : DesignPower
        Its one row, at this d', has the score of one subject and the power of his binomial test, and of the t test of
        a group.
    """

    mode: Mode
    differences: dict[CueName, float]
    by_cue: dict[CueName, float]
    d_prime: float
    power: DesignPower

    def __str__(self) -> str:
        parts = ", ".join(
            f"{cue} {d:.2f} (ln ratio {self.differences[cue]:+.3f})" for cue, d in self.by_cue.items()
        )
        power, row = self.power, self.power.rows[0]
        group = "" if row.group is None else f", of {power.subjects} subjects {100 * row.group:.0f} %"
        return "\n".join([
            f"{power.task} by {self.mode}, {row.rule}: d' {self.d_prime:.2f}: {parts}",
            f"expected score {row.score:.1f} of {power.trials} ({100 * power.lapse:g} % lapses); power of one "
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
    return Prediction(
        mode=mode,
        differences={cue: getattr(pair[0], cue) - getattr(pair[1], cue) for cue in subject.cues},
        by_cue={
            cue: 0.0 if math.isclose(*(getattr(felt, cue) for felt in pair)) else replace(taught, cues=(cue,)).d_prime
            for cue in subject.cues
        },
        d_prime=taught.d_prime,
        power=design_power(
            task, trials=trials, subjects=subjects, rules=(subject.rule,), d_primes=(taught.d_prime,), lapse=subject.lapse
        ),
    )  # fmt: skip


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
        return self._subject.respond(design.task, _towards_boundary(design, trial, cues), rng), None

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
