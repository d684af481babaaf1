"""A whole experiment with simulated subjects, in seconds."""

from __future__ import annotations

import operator
from collections.abc import Sequence

import numpy as np

from burrlab._core import Burr, Material
from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.design import Design, Order
from burrlab.psychophysics.experiment.block import Block
from burrlab.psychophysics.rules import TaskName
from burrlab.psychophysics.simulation.cues import Cues, rendered_cues
from burrlab.psychophysics.simulation.simulated_subject import SimulatedSubject
from burrlab.psychophysics.trial import Interval, Trial

REPLICATES = 3  # seeds of the erosion that a material is drilled with; probing erodes nothing and needs one
SELF_PACED = 10.0  # [s] that a simulated hand takes where the subject ends the interval; ours


def rehearse(
    design: Design,
    subject: SimulatedSubject,
    *,
    subjects: int = 20,
    seed: int,
    burr: Burr | None = None,
    bone: Block | None = None,
) -> list[Counts]:
    """The counts of subjects who are alike, from one seed.

    Parameters
    ----------
    design : Design
        Each subject gets an order of its own. A real specimen is felt as the material that matches it.
    subject : SimulatedSubject
        Who has not been taught is taught by `teach` first.
    subjects : int
    seed : int
        Of orders, noise and lapses.
    burr : Burr, optional
        Default R = 3 mm.
    bone : Block, optional
        Default `Block()`.

    Returns
    -------
    list of Counts
        One a subject, of the main phase.

    Raises
    ------
    ValueError
        If there is no subject, the design's intervals do not have the subject's cues, or the design asks for stiffness by
        drilling, which has no cue for it.

    Notes
    -----
    Each material is rendered once by probing, and with three seeds by drilling; an interval takes one of the three by its
    own seed. So the erosion's scatter is in it (a standard deviation of 0.0001 to 0.0002 of the logarithm at 0.1 mm: nothing
    beside the noise), and a rehearsal of 20 subjects takes seconds rather than an hour. `burrlab experiment run --simulated`
    renders every interval.
    """
    if operator.index(subjects) < 1:
        raise ValueError(f"subjects must be at least 1, got {subjects}")
    names = [f"{number:02d}" for number in range(1, subjects + 1)]
    taught = subject if subject.known is not None else teach(subject, design, burr=burr, bone=bone)
    orders = (rehearsed_order(design, taught, name=name, seed=seed, burr=burr, bone=bone) for name in names)
    return [counts_of(design.task, order.answered) for order in orders]


def rehearsed_order(
    design: Design,
    subject: SimulatedSubject,
    *,
    name: str = "01",
    seed: int,
    burr: Burr | None = None,
    bone: Block | None = None,
) -> Order:
    """The order of one subject with all its answers, where counts are not enough: levels of a staircase.

    Parameters and errors are those of `rehearse`; `name` is the subject's.
    """
    check_rehearsable(design)
    burr, bone = burr or Burr(3.0), bone or Block()
    taught = subject if subject.known is not None else teach(subject, design, burr=burr, bone=bone)
    rng = np.random.default_rng([operator.index(seed), *name.encode()])
    order = design.order(seed=seed, subject=name)
    while (trial := order.next()) is not None:
        felt = [_felt(design, interval, burr, bone) for interval in stood_in(trial)]
        order.answer(taught.respond(trial, felt, rng))
    return order


def teach(
    subject: SimulatedSubject, design: Design, *, burr: Burr | None = None, bone: Block | None = None
) -> SimulatedSubject:
    """The subject who knows the design's two materials; in two-interval tasks unchanged.

    Raises
    ------
    ValueError
        If the design does not have two materials, or its intervals do not have the subject's cues.
    """
    if design.task == "2ifc":
        return subject
    burr, bone = burr or Burr(3.0), bone or Block()
    found: dict[Material, Interval] = {}
    order = design.order(seed=0, subject="taught")
    while len(found) < 2 and (trial := order.next()) is not None:
        for interval in stood_in(trial):
            assert interval.stimulus.material is not None
            found.setdefault(interval.stimulus.material, interval)
        order.answer(design.answers[0])
    if len(found) != 2:
        raise ValueError(f"design must have two materials, got {len(found)}")
    a, b = (_felt(design, interval, burr, bone) for interval in found.values())
    return subject.taught(a, b)


def check_rehearsable(design: Design) -> None:
    """ValueError for a design whose answers depend on what simulated subjects do not feel."""
    if design.mode == "drilling" and getattr(design, "hold", "other") == "sinking speed":
        raise ValueError(
            "design must not hold the sinking speed, the only cue that simulated subjects have by drilling"
        )


def stood_in(trial: Trial) -> tuple[Interval, ...]:
    """The intervals with the matching alternative in a real reference's place, and a length for self-paced ones [s]."""
    intervals = []
    for interval in trial.intervals:
        stimulus = interval.stimulus
        if stimulus.material is None:
            stimulus = trial.intervals[1 if trial.correct == "first" else 2].stimulus
        duration = SELF_PACED if interval.duration is None else interval.duration
        intervals.append(Interval(stimulus, interval.seed, duration))
    return tuple(intervals)


def counts_of(task: TaskName, answered: Sequence[tuple[Trial, str]]) -> Counts:
    """The main phase's answers, counted as `Rule` has them: "different", or "first"."""
    answer = "different" if task == "same-different" else "first"
    main = [(trial, response == answer) for trial, response in answered if trial.phase == "main"]
    by_type: dict[str, tuple[int, int]] = {}
    for trial, given in main:
        times, trials = by_type.get(trial.trial_type, (0, 0))
        by_type[trial.trial_type] = (times + given, trials + 1)
    signal = [given for trial, given in main if trial.correct == answer]
    noise = [given for trial, given in main if trial.correct != answer]
    return Counts(task, sum(signal), len(signal), sum(noise), len(noise), by_type)


def _felt(design: Design, interval: Interval, burr: Burr, bone: Block) -> Cues:
    material, duration = interval.stimulus.material, interval.duration
    assert material is not None
    assert duration is not None
    seed = 1 if design.mode == "probing" else 1 + interval.seed % REPLICATES
    return rendered_cues(material, design.mode, burr=burr, bone=bone, duration=duration, seed=seed)
