"""Simulated subjects decide by the rules that an analysis assumes; rehearsals are a function of their seed.

Proportions are compared with exact ones by a two-sided binomial test of probability 1e-6 that it fails by chance.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binomtest, norm

import burrlab
import burrlab.psychophysics.weber as weber
from burrlab.psychophysics.designs import ABX, SameDifferent
from burrlab.psychophysics.interval import Block, render
from burrlab.psychophysics.observer import (
    Cues,
    SimulatedSubject,
    drilling_hand,
    interval_cues,
    probing_hand,
    rendered_cues,
    task_of,
)
from burrlab.psychophysics.rehearsal import counts_of, noise_for_score, rehearse, stood_in, task1_table, teach
from burrlab.psychophysics.rules import rule_of
from burrlab.psychophysics.staircase import ConstantStimuli, Staircase
from burrlab.psychophysics.trial import Interval, Stimulus, Trial

FALSE_ALARM = 1e-6
MANY = 6000
SEED = 20041107
SMALL = Block((20, 20, 6), 0.2)
A, B = Cues(stiffness=1.0, force=0.0), Cues(stiffness=0.0, force=1.0)
STIMULI = {name: Stimulus(name, burrlab.materials[name]) for name in ("bone", "pettigrew", "pvc")}


def trial(kind, correct):
    letters = "X" + kind if correct in ("first", "second") and kind in ("AB", "BA") else kind
    intervals = tuple(Interval(Stimulus(letter), i, 1.0) for i, letter in enumerate(letters))
    return Trial(1, "main", 1, kind, intervals, correct)


KINDS = {
    "same-different": [("AA", "same", "AA"), ("AB", "different", "AB"), ("BA", "different", "BA"), ("BB", "same", "BB")],
    "abx": [("AB", "first", "AAB"), ("BA", "second", "ABA")],
    "2ifc": [("RC", "first", "AB"), ("CR", "second", "BA")],
}  # fmt: skip


def answers(subject, task, n=MANY, *, a=A, b=B, seed=SEED):
    """[(type, correct, response)] of n trials."""
    rng = np.random.default_rng(seed)
    given = []
    for i in range(n):
        kind, correct, order = KINDS[task][i % len(KINDS[task])]
        felt = [a if letter == "A" else b for letter in order]
        given.append((kind, correct, subject.respond(trial(kind, correct), felt, rng)))
    return given


def agrees(successes, n, p):
    return binomtest(successes, n, p).pvalue > FALSE_ALARM


def right(given):
    return sum(correct == response for _, correct, response in given)


@pytest.mark.parametrize("decision", ["differencing", "covert"])
@pytest.mark.parametrize("task", ["same-different", "abx", "2ifc"])
@pytest.mark.parametrize("d_prime", [0.8, 2.5])
def test_scores_are_those_of_the_rule(task, decision, d_prime):
    subject = SimulatedSubject(1.0 / d_prime, decision=decision).taught(A, B)
    assert subject.d_prime == pytest.approx(d_prime)
    expected = rule_of(task, subject.rule).proportion_correct(d_prime, lapse=0.02)
    assert agrees(right(answers(subject, task)), MANY, float(expected))


@pytest.mark.parametrize("criterion", [0.5, 3.0])
def test_a_criterion_gives_its_rates(criterion):
    subject = SimulatedSubject(0.5, criterion=criterion, lapse=0.0).taught(A, B)
    given = answers(subject, "same-different")
    rates = rule_of("same-different", "differencing").rates(2.0, criterion)
    for kind, rate in zip(("different", "same"), rates, strict=True):
        those = [response == "different" for _, correct, response in given if correct == kind]
        assert agrees(sum(those), len(those), float(rate))


@pytest.mark.parametrize("task", ["same-different", "abx", "2ifc"])
def test_lapses_answer_at_random(task):
    given = answers(SimulatedSubject(0.01, lapse=1.0).taught(A, B), task)
    assert agrees(right(given), MANY, 0.5)
    firsts = sum(response in ("same", "first") for *_, response in given)
    assert agrees(firsts, MANY, 0.5)
    assert right(answers(SimulatedSubject(0.01, lapse=0.0).taught(A, B), task, 40)) == 40


def test_several_cues_are_combined_by_the_best_linear_weights():
    subject = SimulatedSubject({"stiffness": 0.8, "force": 0.5}, ("stiffness", "force"), lapse=0.0)
    subject = subject.taught(A, B)
    assert subject.d_prime == pytest.approx(math.hypot(1 / 0.8, 1 / 0.5))
    expected = rule_of("same-different", "differencing").proportion_correct(subject.d_prime)
    assert agrees(right(answers(subject, "same-different")), MANY, float(expected))


def test_in_two_intervals_more_of_each_cue_is_more():
    a, b = Cues(stiffness=1.0, force=1.0), Cues(stiffness=0.0, force=0.0)
    for subject in (SimulatedSubject(0.7, ("stiffness", "force"), lapse=0.0),
                    SimulatedSubject(0.7, ("stiffness", "force"), lapse=0.0).taught(b, a)):  # fmt: skip
        expected = norm.cdf(math.hypot(1 / 0.7, 1 / 0.7) / math.sqrt(2))
        assert agrees(right(answers(subject, "2ifc", a=a, b=b)), MANY, float(expected))


def test_memory_noise_adds_to_the_first_interval():
    subject = SimulatedSubject(0.4, memory=0.6, lapse=0.0).taught(A, B)
    d_prime = 1.0 / math.sqrt(0.4**2 + 0.6**2 / 2)
    assert subject.d_prime == pytest.approx(d_prime)
    for task in ("same-different", "2ifc"):
        expected = rule_of(task, "differencing").proportion_correct(d_prime)
        assert agrees(right(answers(subject, task)), MANY, float(expected))


def test_every_call_takes_the_same_number_of_draws():
    left = []
    for settings in ({"lapse": 1.0}, {"lapse": 0.0}, {"lapse": 0.0, "memory": 1.0}):
        rng = np.random.default_rng(1)
        SimulatedSubject(0.5, **settings).taught(A, B).respond(trial("AB", "different"), (A, B), rng)
        left.append(rng.random())
    assert len(set(left)) == 1


def test_the_right_answer_is_not_looked_at():
    subject = SimulatedSubject(0.5).taught(A, B)
    for one, other in ((("AA", "same"), ("AB", "different")), (("AB", "first"), ("BA", "second"))):
        felt = (A, B) if one[1] == "same" else (A, A, B)
        said = [
            [subject.respond(trial(*what), felt, np.random.default_rng(i)) for i in range(100)]
            for what in (one, other)
        ]
        assert said[0] == said[1]


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"cues": ()}, r"cues must be some of stiffness, force, sinking, each once, got \(\)"),
        ({"cues": ("hardness",)}, "cues must be some of"),
        ({"cues": ("force", "force")}, "cues must be some of"),
        ({"weber": {"force": 0.1}}, "weber must have a fraction for each cue, stiffness has none"),
        ({"weber": 0.0}, "weber of stiffness must be positive and finite, got 0.0"),
        ({"weber": math.inf}, "weber of stiffness must be positive"),
        ({"decision": "guessing"}, "decision must be one of differencing, covert, got 'guessing'"),
        ({"decision": "covert", "criterion": 1.0}, "criterion must be None for covert decisions, got 1.0"),
        ({"criterion": -1.0}, "criterion must be zero or positive and finite, got -1.0"),
        ({"lapse": 1.1}, "lapse must be from 0 to 1, got 1.1"),
        ({"memory": math.nan}, "memory must be zero or positive and finite, got nan"),
    ],
)
def test_refusals(settings, sentence):
    with pytest.raises(ValueError, match=sentence):
        SimulatedSubject(**{"weber": 0.1, **settings})


def test_refusals_of_teaching_and_answering():
    rng = np.random.default_rng(1)
    subject = SimulatedSubject(0.1)
    with pytest.raises(ValueError, match="must be taught the two materials first"):
        subject.respond(trial("AA", "same"), (A, A), rng)
    with pytest.raises(ValueError, match="must be taught the two materials first"):
        _ = subject.d_prime
    with pytest.raises(ValueError, match="the two known materials must differ in a cue"):
        _ = subject.taught(A, A).d_prime
    with pytest.raises(ValueError, match="cue stiffness must have a value in every interval"):
        subject.taught(A, Cues(sinking=1.0))
    with pytest.raises(ValueError, match="cues must be one an interval, 2, got 1"):
        subject.taught(A, B).respond(trial("AA", "same"), (A,), rng)


def test_published_fractions():
    assert (weber.FORCE, weber.FORCE_CONTRALATERAL) == (0.07, 0.10)
    assert (weber.COMPLIANCE_WITHOUT_WORK, weber.COMPLIANCE_WITH_SURFACE) == (0.22, 0.15)
    assert pytest.approx(3 * weber.COMPLIANCE_WITH_SURFACE) == weber.COMPLIANCE_WITHOUT_SURFACE


def design(b="pvc", **options):
    return SameDifferent(STIMULI["bone"], STIMULI[b], **{"interval": 4.0, **options})


def test_rehearsal_is_a_function_of_its_seed():
    subject = SimulatedSubject(0.36)
    runs = [rehearse(design(), subject, subjects=4, seed=seed, bone=SMALL) for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]
    assert len(runs[0]) == 4
    assert runs[0][:2] == rehearse(design(), subject, subjects=2, seed=1, bone=SMALL)
    assert {counts.trials for counts in runs[0]} == {12}
    assert sorted(runs[0][0].by_type) == ["AA", "AB", "BA", "BB"]


def test_practice_does_not_count():
    found = rehearse(design(practice=4), SimulatedSubject(0.36), subjects=1, seed=1, bone=SMALL)
    assert found[0].trials == 12


def test_rehearsal_scores_as_the_rule_says():
    subject = SimulatedSubject(0.36)
    found = rehearse(design(), subject, subjects=200, seed=SEED, bone=SMALL)
    d_prime = teach(subject, design(), bone=SMALL).d_prime
    expected = rule_of("same-different", "differencing").proportion_correct(d_prime, lapse=0.02)
    assert d_prime == pytest.approx(1.02 / 0.36, rel=0.02)
    assert agrees(sum(counts.score for counts in found), 2400, float(expected))


def test_a_real_reference_is_felt_as_its_match():
    task = ABX(Stimulus("real Pettigrew"), STIMULI["pvc"], match=STIMULI["pettigrew"], interval=3.0)
    subject = SimulatedSubject(0.3, ("sinking",), "covert")
    found = rehearse(task, subject, subjects=60, seed=SEED, bone=SMALL)
    d_prime = teach(subject, task, bone=SMALL).d_prime
    expected = rule_of("abx", "independent-observations").proportion_correct(d_prime, lapse=0.02)
    assert agrees(sum(counts.score for counts in found), 600, float(expected))
    first = task.order(seed=1, subject="01").next()
    assert first is not None
    assert stood_in(first)[0].stimulus.name == "pettigrew"
    assert stood_in(first)[0].duration == 10.0


@pytest.mark.parametrize(
    ("parameter", "mode", "cue", "more"),
    [("c_e", "probing", "stiffness", 2 / 3 * math.log(1.4)), ("alpha", "drilling", "sinking", None)],
)
def test_two_intervals_are_rehearsed_too(parameter, mode, cue, more):
    task = ConstantStimuli(STIMULI["bone"], parameter, [1.4], mode=mode, repeats=12, interval=4.0)
    subject = SimulatedSubject(0.25, (cue,))
    found = rehearse(task, subject, subjects=100, seed=SEED, bone=SMALL)
    if more is None:
        pair = [
            rendered_cues(material, mode, burr=burrlab.Burr(3.0), bone=SMALL, duration=4.0).sinking
            for material in (task.comparison(1.4).material, burrlab.materials["bone"])
        ]
        more = pair[0] - pair[1]
    expected = 0.98 * norm.cdf(more / 0.25 / math.sqrt(2)) + 0.01
    assert agrees(sum(counts.score for counts in found), 1200, float(expected))


def test_a_staircase_is_rehearsed():
    task = Staircase(STIMULI["bone"], "c_e", interval=2.0)
    found = rehearse(task, SimulatedSubject(0.1), subjects=1, seed=SEED, bone=SMALL)
    assert found[0].trials > 10


def test_rehearsal_refusals():
    held = ConstantStimuli(STIMULI["bone"], "c_e", [1.4], mode="drilling", hold="sinking speed")
    with pytest.raises(ValueError, match="design must not hold the sinking speed"):
        rehearse(held, SimulatedSubject(0.3, ("sinking",)), seed=1)
    with pytest.raises(ValueError, match="subjects must be at least 1, got 0"):
        rehearse(design(), SimulatedSubject(0.3), subjects=0, seed=1)
    with pytest.raises(ValueError, match="cue sinking must have a value"):
        rehearse(design(), SimulatedSubject(0.3, ("sinking",)), seed=1, bone=SMALL)
    alike = SameDifferent(STIMULI["bone"], Stimulus("again", burrlab.materials["bone"]), interval=2.0)
    with pytest.raises(ValueError, match="design must have two materials, got 1"):
        rehearse(alike, SimulatedSubject(0.3), seed=1, bone=SMALL)


def test_counts_are_of_different_and_of_first():
    pairs = [(trial(kind, correct), "different") for kind, correct, _ in KINDS["same-different"]]
    counts = counts_of("same-different", pairs)
    assert (counts.hits, counts.signals, counts.false_alarms, counts.noises) == (2, 2, 2, 2)
    counts = counts_of("abx", [(trial("AB", "first"), "first"), (trial("BA", "second"), "second")])
    assert (counts.hits, counts.signals, counts.false_alarms, counts.noises) == (1, 1, 0, 1)
    assert [task_of(trial(k, c)) for k, c in (("AA", "same"), ("AB", "first"), ("RC", "first"))] == [
        "same-different",
        "abx",
        "2ifc",
    ]


def test_table_of_task_one():
    table = task1_table(bone=Block(voxel=0.2))
    at = table.row
    assert 8.5 < at("probing stiffness", "bone-pettigrew", "differencing", 0.10).score < 9.5
    assert 8.5 < at("probing stiffness", "bone-pettigrew", "covert", 0.10).score < 9.5
    assert at("probing stiffness", "bone-pettigrew", "differencing", 0.45).low < 6.0  # chance
    assert table.noise_of_published["probing stiffness", "differencing"] == pytest.approx(0.37, abs=0.01)
    assert table.noise_of_published["probing stiffness", "covert"] == pytest.approx(0.45, abs=0.01)
    # Depth after 20 s: bone and PVC are told apart at any published noise, bone and Pettigrew are not at 45 %.
    assert at("sinking speed", "bone-pvc", "differencing", 0.45).score > 11.3
    assert at("sinking speed", "bone-pettigrew", "differencing", 0.45).score < 7.5
    assert table.noise_of_published["sinking speed", "differencing"] > 0.8
    both = at("all", "bone-pvc", "differencing", 1.0)
    assert both.d_prime == pytest.approx(math.sqrt(sum(v**2 for v in table.differences["bone-pvc"].values())))
    assert "bone-pettigrew" in str(table)
    assert len(table.to_dict()["rows"]) == 4 * 3 * 2 * 8
    assert repr(table) == "TaskOneTable(192 rows, differences rendered)"


def test_table_of_given_differences_and_its_refusals():
    given = {"bone-pvc": {"stiffness": 1.0, "force": 0.0, "sinking": 0.0}}
    table = task1_table(differences=given, noises=(0.5,), lapse=0.0)
    row = table.row("probing stiffness", "bone-pvc", "covert", 0.5)
    p = norm.cdf(1.0) ** 2 + norm.cdf(-1.0) ** 2
    assert row.score == pytest.approx(12 * p)
    assert row.high - row.score == pytest.approx(1.959964 * math.sqrt(12 * p * (1 - p) / 20))
    assert table.noise_of_published["sinking speed", "covert"] is None
    with pytest.raises(ValueError, match="the table has no row probing force, bone-ivory, covert"):
        table.row("probing force", "bone-ivory", "covert", 0.5)
    with pytest.raises(
        ValueError, match="differences must be 'rendered', 'closed form' or a mapping, got 'felt'"
    ):
        task1_table(differences="felt")
    with pytest.raises(ValueError, match=r"noises must be positive and finite, got 0\.0"):
        task1_table(differences=given, noises=(0.0,))


@pytest.mark.parametrize("decision", ["differencing", "covert"])
def test_noise_for_a_score(decision):
    noise = noise_for_score(9.0, 1.0, decision)
    assert noise is not None
    table = task1_table(differences={"x": {"stiffness": 1.0, "force": 0.0, "sinking": 0.0}}, noises=(noise,))
    assert table.row("probing stiffness", "x", decision, noise).score == pytest.approx(9.0)
    assert noise_for_score(11.99, 1.0, decision) is None
    assert noise_for_score(5.0, 1.0, decision) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "cue", "noise"), [("probing", "stiffness", 0.36), ("drilling", "sinking", 0.7)]
)
def test_every_interval_rendered_scores_as_the_table_says(mode, cue, noise):
    burr, bone, task = burrlab.Burr(3.0), Block(voxel=0.2), design(mode=mode, interval=20.0)
    subject = teach(SimulatedSubject(noise, (cue,)), task, bone=bone)
    rng, score, trials = np.random.default_rng(SEED), 0, 0
    for number in range(5):
        order = task.order(seed=SEED, subject=f"{number:02d}")
        while (one := order.next()) is not None:
            felt = []
            for interval in one.intervals:
                hand = probing_hand(burr) if mode == "probing" else drilling_hand(burr)
                rendered = render(interval, hand, burr=burr, bone=bone, mode=mode, wall_clock=False)
                assert rendered.ended == "time"
                felt.append(interval_cues(rendered))
            response = subject.respond(one, felt, rng)
            score, trials = score + (response == one.correct), trials + 1
            order.answer(response)
    name = "probing stiffness" if mode == "probing" else "sinking speed"
    expected = task1_table(bone=bone).row(name, "bone-pvc", "differencing", noise).score / 12
    assert agrees(score, trials, expected)
