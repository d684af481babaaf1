"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.abx import ABX
from burrlab.psychophysics.adaptive import AdaptiveStaircase
from burrlab.psychophysics.analysis import analyse
from burrlab.psychophysics.analysis_result import Analysis
from burrlab.psychophysics.answer_file import AnswerFile
from burrlab.psychophysics.answers import Answer, Answers, read_answers, read_folder
from burrlab.psychophysics.block import Block
from burrlab.psychophysics.constant_stimuli import ConstantStimuli
from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.cues import Cues, closed_form_cues, interval_cues, rendered_cues
from burrlab.psychophysics.d_prime import DPrime, binomial_test, d_prime, score_interval
from burrlab.psychophysics.design_size import subjects_needed, trials_needed
from burrlab.psychophysics.equivalence import Equivalence, equivalence
from burrlab.psychophysics.experimenter import Experimenter
from burrlab.psychophysics.group import (
    GroupScore,
    ScoreDifference,
    compare_conditions,
    compare_groups,
    group_score,
)
from burrlab.psychophysics.group_d_prime import GroupDPrime, group_d_prime
from burrlab.psychophysics.hands import drilling_hand, probing_hand
from burrlab.psychophysics.interval import ENDINGS, Rendered, render
from burrlab.psychophysics.orders import counterbalanced
from burrlab.psychophysics.pair_checks import PairCheck, pair_checks
from burrlab.psychophysics.power import DesignPower, design_power
from burrlab.psychophysics.prediction import Prediction, predicted_d_prime
from burrlab.psychophysics.protocol import Protocol
from burrlab.psychophysics.protocol_template import template
from burrlab.psychophysics.psychometric import psychometric_function
from burrlab.psychophysics.psychometric_fit import PsychometricFit
from burrlab.psychophysics.published_score import PublishedScore, group_score_from
from burrlab.psychophysics.rehearsal import rehearse, rehearsed_order, teach
from burrlab.psychophysics.rules import rule_of
from burrlab.psychophysics.runner import DeviceLost, Rig, Runner
from burrlab.psychophysics.same_different import SameDifferent
from burrlab.psychophysics.scored_task import ScoredTask
from burrlab.psychophysics.seat import Seat
from burrlab.psychophysics.selection import SelectionEffect
from burrlab.psychophysics.simulated_seat import SimulatedSeat
from burrlab.psychophysics.simulated_subject import SimulatedSubject
from burrlab.psychophysics.sitting import Sitting
from burrlab.psychophysics.staircase import Staircase
from burrlab.psychophysics.subject_tests import SubjectTest
from burrlab.psychophysics.task_one import TaskOneTable, task1_table
from burrlab.psychophysics.terminal import TerminalSeat
from burrlab.psychophysics.threshold_task import ThresholdTask
from burrlab.psychophysics.tost import SignedEquivalence, tost
from burrlab.psychophysics.trial import Interval, Stimulus, Trial

__all__ = [
    "ABX",
    "ENDINGS",
    "AdaptiveStaircase",
    "Analysis",
    "Answer",
    "AnswerFile",
    "Answers",
    "Block",
    "ConstantStimuli",
    "Counts",
    "Cues",
    "DPrime",
    "DesignPower",
    "DeviceLost",
    "Equivalence",
    "Experimenter",
    "GroupDPrime",
    "GroupScore",
    "Interval",
    "PairCheck",
    "Prediction",
    "Protocol",
    "PsychometricFit",
    "PublishedScore",
    "Rendered",
    "Rig",
    "Runner",
    "SameDifferent",
    "ScoreDifference",
    "ScoredTask",
    "Seat",
    "SelectionEffect",
    "SignedEquivalence",
    "SimulatedSeat",
    "SimulatedSubject",
    "Sitting",
    "Staircase",
    "Stimulus",
    "SubjectTest",
    "TaskOneTable",
    "TerminalSeat",
    "ThresholdTask",
    "Trial",
    "analyse",
    "binomial_test",
    "closed_form_cues",
    "compare_conditions",
    "compare_groups",
    "counterbalanced",
    "d_prime",
    "design_power",
    "drilling_hand",
    "equivalence",
    "group_d_prime",
    "group_score",
    "group_score_from",
    "interval_cues",
    "pair_checks",
    "predicted_d_prime",
    "probing_hand",
    "psychometric_function",
    "read_answers",
    "read_folder",
    "rehearse",
    "rehearsed_order",
    "render",
    "rendered_cues",
    "rule_of",
    "score_interval",
    "subjects_needed",
    "task1_table",
    "teach",
    "template",
    "tost",
    "trials_needed",
]
