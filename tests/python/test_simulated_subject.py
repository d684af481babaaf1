"""Simulated hands, cues and subjects, who decide by the analysis's rules; rehearsals depend on the seed only.

Proportions are compared with exact ones by a two-sided binomial test that fails by chance with a probability
of 1e-6.
"""

import itertools
import math

import numpy as np
import pytest
from scipy.stats import binom, binomtest, norm
from session_scenes import refused

import burrlab
from burrlab.psychophysics import ABX, ConstantStimuli, Interval, SameDifferent, Staircase, Stimulus
from burrlab.psychophysics.interval import TICK, Block, Rendered, render
from burrlab.psychophysics.observer import (
    Cues,
    SimulatedSubject,
    closed_form_cues,
    drilling_hand,
    interval_cues,
    probing_hand,
    rendered_cues,
)
from burrlab.psychophysics.rehearsal import (
    predicted_d_prime,
    rehearse,
    stood_in,
    teach,
)
from burrlab.psychophysics.rules import counts_of, rule_of

FALSE_ALARM = 1e-6
MANY = 6000
SEED = 20041107
SMALL = Block((20, 20, 6), 0.2)
COARSE = Block(voxel=0.2)
BURR = burrlab.Burr(3.0)
A, B = Cues(stiffness=1.0, force=0.0), Cues(stiffness=0.0, force=1.0)
STIMULI = {name: Stimulus(name, burrlab.materials[name]) for name in ("bone", "pettigrew", "pvc")}


KINDS = {
    "same-different": [("AA", "same", "AA"), ("AB", "different", "AB"), ("BA", "different", "BA"), ("BB", "same", "BB")],
    "abx": [("AB", "first", "AAB"), ("BA", "second", "ABA")],
    "2ifc": [("RC", "first", "AB"), ("CR", "second", "BA")],
}  # fmt: skip


def answers(subject, task, n=MANY, *, a=A, b=B, seed=SEED):
    """[(type, correct answer, response)] of n trials."""
    rng = np.random.default_rng(seed)
    return [
        (kind, correct, subject.respond(task, [a if letter == "A" else b for letter in order], rng))
        for kind, correct, order in itertools.islice(itertools.cycle(KINDS[task]), n)
    ]  # fmt: skip


def agrees(successes, n, p):
    return binomtest(successes, n, p).pvalue > FALSE_ALARM


def right(given):
    return sum(correct == response for _, correct, response in given)


def scores_as(subject, task, d_prime, lapse=0.0, **cues):
    expected = rule_of(task, subject.rule).proportion_correct(d_prime, lapse=lapse)
    assert agrees(right(answers(subject, task, **cues)), MANY, float(expected))


@pytest.mark.parametrize("decision", ["differencing", "covert"])
@pytest.mark.parametrize("task", ["same-different", "abx", "2ifc"])
def test_scores_are_those_of_the_rule(task, decision):
    subject = SimulatedSubject(0.4, decision=decision).taught(A, B)
    assert subject.d_prime == pytest.approx(2.5)
    scores_as(subject, task, 2.5, lapse=0.02)


@pytest.mark.parametrize("criterion", [0.5, 3.0])
def test_a_criterion_gives_its_rates(criterion):
    given = answers(SimulatedSubject(0.5, criterion=criterion, lapse=0.0).taught(A, B), "same-different")
    rates = rule_of("same-different", "differencing").rates(2.0, criterion)
    for kind, rate in zip(("different", "same"), rates, strict=True):
        those = [response == "different" for _, correct, response in given if correct == kind]
        assert agrees(sum(those), len(those), float(rate))


@pytest.mark.parametrize("task", ["same-different", "abx", "2ifc"])
def test_lapses_answer_at_random(task):
    given = answers(SimulatedSubject(0.01, lapse=1.0).taught(A, B), task)
    assert agrees(right(given), MANY, 0.5)
    assert agrees(sum(response in ("same", "first") for *_, response in given), MANY, 0.5)
    assert right(answers(SimulatedSubject(0.01, lapse=0.0).taught(A, B), task, 40)) == 40


def test_several_cues_are_combined_by_the_best_linear_weights():
    both = ("stiffness", "force")
    subject = SimulatedSubject({"stiffness": 0.8, "force": 0.5}, both, lapse=0.0).taught(A, B)
    assert subject.d_prime == pytest.approx(math.hypot(1 / 0.8, 1 / 0.5))
    scores_as(subject, "same-different", subject.d_prime)
    # In two intervals more of any cue counts as more.
    a, b, subject = Cues(1.0, 1.0), Cues(0.0, 0.0), SimulatedSubject(0.7, both, lapse=0.0)
    for one in (subject, subject.taught(b, a)):
        scores_as(one, "2ifc", math.hypot(1 / 0.7, 1 / 0.7), a=a, b=b)


def test_memory_noise_adds_to_the_first_interval():
    subject = SimulatedSubject(0.4, memory=0.6, lapse=0.0).taught(A, B)
    d_prime = 1.0 / math.sqrt(0.4**2 + 0.6**2 / 2)
    assert subject.d_prime == pytest.approx(d_prime)
    for task in ("same-different", "2ifc"):
        scores_as(subject, task, d_prime)


def test_every_call_takes_the_same_number_of_draws():
    left = []
    for settings in ({"lapse": 1.0}, {"lapse": 0.0}, {"lapse": 0.0, "memory": 1.0}):
        rng = np.random.default_rng(1)
        SimulatedSubject(0.5, **settings).taught(A, B).respond("same-different", (A, B), rng)
        left.append(rng.random())
    assert len(set(left)) == 1


def design(b="pvc", **options):
    return SameDifferent(STIMULI["bone"], STIMULI[b], **{"interval": 4.0, **options})


def test_rehearsal_is_a_function_of_its_seed():
    subject = SimulatedSubject(0.36)
    runs = [rehearse(design(), subject, subjects=4, seed=seed, bone=SMALL) for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]
    assert runs[0][:2] == rehearse(design(), subject, subjects=2, seed=1, bone=SMALL)
    assert [counts.trials for counts in runs[0]] == [12] * 4
    assert sorted(runs[0][0].by_type) == ["AA", "AB", "BA", "BB"]
    task = Staircase(STIMULI["bone"], "c_e", interval=2.0)
    assert rehearse(task, SimulatedSubject(0.1), subjects=1, seed=SEED, bone=SMALL)[0].trials > 10


REAL = ABX(Stimulus("real Pettigrew"), STIMULI["pvc"], match=STIMULI["pettigrew"], interval=3.0)


@pytest.mark.parametrize(
    ("task", "subject", "subjects", "d_prime"),
    [
        (design(practice=4), SimulatedSubject(0.36), 100, pytest.approx(1.02 / 0.36, rel=0.02)),
        (REAL, SimulatedSubject(0.3, ("sinking",), "covert"), 60, pytest.approx(6.64, abs=0.1)),
    ],
    ids=["same-different", "a real reference"],
)
def test_rehearsal_scores_as_the_rule_says(task, subject, subjects, d_prime):
    """Practice is not counted."""
    found = rehearse(task, subject, subjects=subjects, seed=SEED, bone=SMALL)
    assert {counts.trials for counts in found} == {task.trials}
    taught = teach(subject, task, bone=SMALL).d_prime
    assert taught == d_prime
    expected = rule_of(task.task, subject.rule).proportion_correct(taught, lapse=0.02)
    assert agrees(sum(counts.score for counts in found), task.trials * subjects, float(expected))


def test_a_real_reference_is_felt_as_its_match():
    felt = stood_in(REAL, REAL.order(seed=1, subject="01").next().intervals[0])
    assert (felt.stimulus.name, felt.duration) == ("pettigrew", 10.0)


@pytest.mark.parametrize(
    ("parameter", "mode", "cue", "more"),
    [("c_e", "probing", "stiffness", 2 / 3 * math.log(1.4)), ("alpha", "drilling", "sinking", None)],
)
def test_two_intervals_are_rehearsed_too(parameter, mode, cue, more):
    task = ConstantStimuli(STIMULI["bone"], parameter, [1.4], mode=mode, repeats=12, interval=4.0)
    found = rehearse(task, SimulatedSubject(0.25, (cue,)), subjects=60, seed=SEED, bone=SMALL)
    if more is None:
        pair = (task.comparison(1.4).material, burrlab.materials["bone"])
        fast, slow = (rendered_cues(x, mode, burr=BURR, bone=SMALL, duration=4.0).sinking for x in pair)
        more = fast - slow
    expected = 0.98 * norm.cdf(more / 0.25 / math.sqrt(2)) + 0.01
    assert agrees(sum(counts.score for counts in found), 720, float(expected))


@pytest.mark.parametrize(
    ("task", "signal", "expected"),
    [
        ("same-different", "different", (2, 2, 2, 3)),
        ("abx", "first", (1, 2, 1, 1)),
        ("2ifc", "first", (1, 2, 1, 1)),
    ],
)
def test_counts_are_of_different_and_of_first(task, signal, expected):
    answered = [(kind, signal, correct) for kind, correct, _ in KINDS[task]]
    found = counts_of(task, [*answered, (KINDS[task][0][0], "another", KINDS[task][0][1])])
    assert (found.hits, found.signals, found.false_alarms, found.noises) == expected


def predicted(cue, noise, *, pair=("bone", "pvc"), decision="differencing"):
    """The expected score of 12 of an observer with this noise of one cue, by the cues of rendered intervals."""
    materials = (burrlab.materials[name] for name in pair)
    mode = "drilling" if cue == "sinking" else "probing"
    subject = SimulatedSubject(noise, (cue,), decision)
    return predicted_d_prime(*materials, mode, subject, bone=COARSE).power.rows[0]


def test_scores_of_task_one():
    harder = ("bone", "pettigrew")
    for decision, noise in (("differencing", 0.37), ("covert", 0.45)):
        assert 8.5 < predicted("stiffness", 0.10, pair=harder, decision=decision).score < 9.5
        # the paper's mean for bone and PVC
        less, more = (predicted("stiffness", noise + x, decision=decision).score for x in (-0.01, 0.01))
        assert less > 9.3 > more
    chance = predicted("stiffness", 0.45, pair=harder)
    assert chance.score - 1.96 * chance.score_sd / math.sqrt(20) < 6.0
    # Depth after 20 s tells bone from PVC at any published noise, but not bone from Pettigrew at 45 %.
    assert predicted("sinking", 0.45).score > 11.3
    assert predicted("sinking", 0.45, pair=harder).score < 7.5
    assert predicted("sinking", 0.8).score > 9.6  # the paper's mean


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "cue", "noise"), [("probing", "stiffness", 0.36), ("drilling", "sinking", 0.7)]
)
def test_every_interval_rendered_scores_as_predicted(mode, cue, noise, monkeypatch):
    def felt(task, interval, burr, bone):
        hand = probing_hand(burr) if mode == "probing" else drilling_hand(burr)
        rendered = render(interval, hand, burr=burr, bone=bone, mode=mode, wall_clock=False)
        assert rendered.ended == "time"
        return interval_cues(rendered)

    monkeypatch.setattr("burrlab.psychophysics.rehearsal._felt", felt)
    task = design(mode=mode, interval=20.0)
    found = rehearse(task, SimulatedSubject(noise, (cue,)), subjects=5, seed=SEED, bone=COARSE)
    assert agrees(sum(counts.score for counts in found), 60, predicted(cue, noise).score / 12)


NAMES = ["bone", "pettigrew", "pvc"]


def made(force, depth, *, mode="probing"):
    """An interval with this force [N] and immersion [mm] at each tick; penetration is half the immersion."""
    ticks = np.zeros(len(force), TICK)
    ticks["time"], ticks["periods"] = 0.001 * np.arange(len(force)), 1
    ticks["center"][:, 2], ticks["force"][:, 2] = BURR.radius - np.asarray(depth), force
    ticks["penetration"], ticks["touching"] = 0.5 * np.maximum(depth, 0), np.asarray(depth) > 0
    return Rendered(mode, "time", 0.001 * len(ticks), 0.001 * float(ticks["touching"].sum()), BURR, ticks)


def press(peak, deepest, n=200):
    part = np.sin(np.pi * np.arange(n) / n)
    return peak * part, deepest * part


@pytest.mark.parametrize(("name", "voxel"), [*((name, 0.2) for name in NAMES), ("bone", 0.1)])
def test_probing_gives_what_the_equations_say(name, voxel):
    found = rendered_cues(burrlab.materials[name], "probing", burr=BURR, bone=Block(voxel=voxel))
    expected = closed_form_cues(burrlab.materials[name], burr=BURR)
    assert found.presses == 10
    assert found.stiffness == pytest.approx(expected.stiffness, abs=0.004)  # peaks are up to 1 % below 1.5 N
    assert found.force == pytest.approx(expected.force, abs=0.01)
    assert math.isnan(found.sinking)
    again = rendered_cues(burrlab.materials[name], "probing", burr=burrlab.Burr(3.0), bone=Block(voxel=voxel))
    assert again is found


def test_closed_forms_of_the_paper():
    """Those of bone and PVC stand in the docstring."""
    bone, pettigrew = (closed_form_cues(burrlab.materials[name], burr=BURR) for name in NAMES[:2])
    assert bone.stiffness - pettigrew.stiffness == pytest.approx(0.24, abs=0.005)
    assert pettigrew.sinking - bone.sinking == pytest.approx(1.23, abs=0.01)
    assert closed_form_cues(burrlab.Material("still", c_e=1.0, alpha=0.0), burr=BURR).sinking == -math.inf


def test_depth_after_a_time_tells_less_than_speed_at_a_depth():
    # By the thin-layer law speed goes as 1/H^2 at small H, so H goes as the cube root of the speed's factor.
    bone, pvc = (
        rendered_cues(burrlab.materials[n], "drilling", burr=BURR, bone=COARSE) for n in ("bone", "pvc")
    )
    assert np.isnan([bone.stiffness, bone.force]).all()
    assert 5.17 / 3 < pvc.sinking - bone.sinking < 5.17 / 1.8


def test_the_erosion_scatters_little():
    found = [
        rendered_cues(burrlab.materials["bone"], "drilling", burr=BURR, bone=COARSE, seed=seed).sinking
        for seed in range(1, 5)
    ]
    assert 0.0 < np.std(found, ddof=1) < 0.005


def test_each_press_counts_once_and_the_mean_comes_before_the_logarithm():
    parts = [press(1.0, 0.5), press(2.0, 0.5), press(0.3, 0.5)]
    found = interval_cues(made(*(np.concatenate(column) for column in zip(*parts, strict=True))))
    assert found.presses == 2  # the third does not reach half of the largest
    assert found.stiffness == pytest.approx(math.log((1.0 / 0.25 + 2.0 / 0.25) / 2), abs=1e-9)
    # Linear between ticks: the sine's force at 0.2 of 0.5 mm is 0.4 of the peak.
    assert found.force == pytest.approx(math.log((0.4 + 0.8) / 2), abs=1e-4)


def test_a_tremble_does_not_make_two_presses_of_one():
    force, depth = press(1.0, 0.5, 400)
    assert interval_cues(made(force - 0.3 * (np.arange(400) == 200), depth)).presses == 1
    assert math.isnan(interval_cues(made(force, depth + 0.3)).force)  # deeper all the time


@pytest.mark.parametrize("mode", ["probing", "drilling"])
@pytest.mark.parametrize("ticks", [10, 0])
def test_nothing_felt_is_nothing_known(mode, ticks):
    zero = np.zeros(ticks)
    found = interval_cues(made(zero, zero - 1.0, mode=mode))
    assert np.isnan([found.stiffness, found.force, found.sinking]).all()
    assert found.presses == 0


def test_sinking_is_depth_over_contact():
    depth = np.concatenate(
        [np.full(100, -1.0), np.linspace(0.01, 2.0, 400), np.full(100, 1.0), np.full(50, -1.0)]
    )
    found = interval_cues(made(np.where(depth > 0, 0.3, 0.0), depth, mode="drilling"))
    assert found.sinking == pytest.approx(math.log(2.0 / 0.5))


@pytest.mark.parametrize("name", ["bone", "pvc"])
def test_twenty_seconds_of_drilling_stay_within_the_default_block(name):
    interval = Interval(STIMULI[name], 1, 20.0)
    found = render(interval, drilling_hand(BURR), burr=BURR, bone=COARSE, mode="drilling", wall_clock=False)
    force, x = found.ticks["force"][:, 2], found.ticks["center"][:, 0]
    assert found.ended == "time"
    # The push on a burr that sinks at v is less by grip v follow and damping v.
    speed = np.ptp(found.immersion[[5000, -1]]) / (0.001 * (len(force) - 5001))
    assert force[5000:].mean() == pytest.approx(0.3 - (0.4 * 0.2 + 0.005) * speed, rel=0.02)
    crossings = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0) & (np.arange(len(x) - 1) > 2000))
    assert 1000 / np.diff(crossings).mean() == pytest.approx(1.4, rel=0.01)
    assert 3.5 < np.ptp(x[2000:]) < 5.0  # the hole's walls take part of the stroke of 5 mm
    assert found.ticks["on"].all()


BONE, PETTIGREW, PVC = (burrlab.materials[name] for name in ("bone", "pettigrew", "pvc"))


def test_closed_form_of_stiffness():
    found = predicted_d_prime(
        BONE, PVC, "probing", SimulatedSubject(0.36, lapse=0.0, decision="covert"), closed_form=True
    )
    d_prime = 2 / 3 * math.log(BONE.c_e / PVC.c_e) / 0.36
    assert (found.d_prime, found.by_cue) == (pytest.approx(d_prime), {"stiffness": pytest.approx(d_prime)})
    p = norm.cdf(d_prime / 2) ** 2 + norm.cdf(-d_prime / 2) ** 2
    (row,) = found.power.rows
    assert (row.score, row.rule) == (pytest.approx(12 * p), "independent-observations")
    assert row.score_sd == pytest.approx(math.sqrt(12 * p * (1 - p)))
    # 10 of 12 are needed at 5 %; without bias both kinds of trial have the same proportion correct.
    assert row.subject == pytest.approx(binom.sf(9, 12, p))


def test_cues_add_in_squares_and_rendered_ones_are_those_of_the_equations():
    subject = SimulatedSubject({"stiffness": 0.3, "force": 0.2}, ("stiffness", "force"))
    found = predicted_d_prime(BONE, PETTIGREW, "probing", subject, bone=COARSE)
    exact = predicted_d_prime(BONE, PETTIGREW, "probing", subject, closed_form=True)
    assert found.d_prime == pytest.approx(math.hypot(*found.by_cue.values()))
    assert found.d_prime == pytest.approx(exact.d_prime, rel=0.01)


def test_alike_materials_are_never_told_apart():
    held = burrlab.Material("held", c_e=BONE.c_e, alpha=2 * BONE.alpha)
    refused(
        (
            lambda: predicted_d_prime(BONE, held, "probing", SimulatedSubject(0.3), closed_form=True),
            "the two known materials must differ in a cue",
        )
    )
    # A difference in alpha alone is felt as sinking only.
    found = predicted_d_prime(BONE, held, "drilling", SimulatedSubject(0.3, ("sinking",)), closed_form=True)
    assert found.d_prime == pytest.approx(math.log(2) / 0.3)


def subject_with(**change):
    return lambda: SimulatedSubject(**{"weber": 0.1, **change})


def prediction(mode, **change):
    return lambda: predicted_d_prime(BONE, PVC, mode, SimulatedSubject(0.3, **change))


RNG = np.random.default_rng(1)
SUBJECT = SimulatedSubject(0.1)
SINKING = SimulatedSubject(0.3, ("sinking",))
HELD = ConstantStimuli(STIMULI["bone"], "c_e", [1.4], mode="drilling", hold="sinking speed")
ALIKE = SameDifferent(STIMULI["bone"], Stimulus("again", BONE), interval=2.0)


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (subject_with(cues=()), r"cues must be some of stiffness, force, sinking, change, each once, got \(\)"),
        (subject_with(cues=("hardness",)), "cues must be some of"),
        (subject_with(cues=("force", "force")), "cues must be some of"),
        (subject_with(weber={"force": 0.1}), "weber must have a fraction for each cue, stiffness has none"),
        (subject_with(weber=0.0), "weber of stiffness must be positive and finite, got 0.0"),
        (subject_with(weber=math.inf), "weber of stiffness must be positive"),
        (subject_with(decision="guessing"), "decision must be one of differencing, covert, got 'guessing'"),
        (subject_with(decision="covert", criterion=1.0),
         "criterion must be None for covert decisions, got 1.0"),
        (subject_with(criterion=-1.0), "criterion must be zero or positive and finite, got -1.0"),
        (subject_with(lapse=1.1), "lapse must be from 0 to 1, got 1.1"),
        (subject_with(memory=math.nan), "memory must be zero or positive and finite, got nan"),
        (lambda: SUBJECT.respond("same-different", (A, A), RNG), "must be taught the two materials first"),
        (lambda: SUBJECT.d_prime, "must be taught the two materials first"),
        (lambda: SUBJECT.taught(A, A).d_prime, "the two known materials must differ in a cue"),
        (lambda: SUBJECT.taught(A, Cues(sinking=1.0)), "cue stiffness must have a value in every interval"),
        (lambda: SUBJECT.taught(A, B).respond("same-different", (A,), RNG),
         "cues must be one an interval, 2, got 1"),
        (lambda: rehearse(design(), SUBJECT, subjects=0, seed=1), "subjects must be at least 1, got 0"),
        (lambda: rehearse(design(), SINKING, seed=1, bone=SMALL), "cue sinking must have a value"),
        (lambda: rehearse(HELD, SINKING, seed=1), "design must not hold the sinking speed"),
        (lambda: rehearse(ALIKE, SUBJECT, seed=1, bone=SMALL), "design must have two materials, got 1"),
        (lambda: probing_hand(BURR, push=-1), "push must be zero or positive"),
        (lambda: probing_hand(BURR, presses=-1), "presses must be zero or positive"),
        (lambda: drilling_hand(BURR, push=-1), "push must be zero or positive"),
        (lambda: drilling_hand(BURR, stroke=-1), "amplitude must be zero or positive"),
        (lambda: drilling_hand(BURR, strokes=-1), "strokes must be zero or positive"),
        (prediction("looking"), "mode must be one of probing, drilling, got 'looking'"),
        (prediction("drilling"), "cues must be of the mode, drilling has sinking, change, got 'stiffness'"),
        (prediction("probing", criterion=1.0), r"criterion must be None for a prediction, got 1\.0"),
    ],
)  # fmt: skip
def test_refusals(ask, sentence):
    refused((ask, sentence))
