"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.designs.abx import ABX
from burrlab.psychophysics.designs.adaptive import AdaptiveStaircase
from burrlab.psychophysics.designs.constant_stimuli import ConstantStimuli
from burrlab.psychophysics.designs.orders import counterbalanced
from burrlab.psychophysics.designs.psychometric import psychometric_function
from burrlab.psychophysics.designs.psychometric_fit import PsychometricFit
from burrlab.psychophysics.designs.same_different import SameDifferent
from burrlab.psychophysics.designs.staircase import Staircase
from burrlab.psychophysics.experiment.answer_file import AnswerFile
from burrlab.psychophysics.experiment.answer_reading import read_answers, read_folder
from burrlab.psychophysics.experiment.answer_row import Answer
from burrlab.psychophysics.experiment.answers import Answers
from burrlab.psychophysics.experiment.block import Block
from burrlab.psychophysics.experiment.interval import Rendered, render
from burrlab.psychophysics.experiment.protocol import Protocol
from burrlab.psychophysics.experiment.protocol_template import template
from burrlab.psychophysics.experiment.runner import DeviceLost
from burrlab.psychophysics.experiment.seat import Seat
from burrlab.psychophysics.experiment.sitting import Sitting
from burrlab.psychophysics.experiment.terminal import TerminalSeat
from burrlab.psychophysics.experiment.volume_block import VolumeBlock
from burrlab.psychophysics.report.analysis import analyse
from burrlab.psychophysics.report.analysis_result import Analysis
from burrlab.psychophysics.report.scored_task import ScoredTask
from burrlab.psychophysics.report.threshold_task import ThresholdTask
from burrlab.psychophysics.rules import rule_of
from burrlab.psychophysics.simulation import weber
from burrlab.psychophysics.simulation.cues import Cues, closed_form_cues, interval_cues, rendered_cues
from burrlab.psychophysics.simulation.hands import drilling_hand, probing_hand
from burrlab.psychophysics.simulation.prediction import Prediction, predicted_d_prime
from burrlab.psychophysics.simulation.rehearsal import rehearse, rehearsed_order, teach
from burrlab.psychophysics.simulation.simulated_subject import SimulatedSubject
from burrlab.psychophysics.simulation.task_one import TaskOneTable, task1_table
from burrlab.psychophysics.statistics.d_prime import DPrime, binomial_test, d_prime, score_interval
from burrlab.psychophysics.statistics.design_size import subjects_needed, trials_needed
from burrlab.psychophysics.statistics.equivalence import Equivalence, equivalence
from burrlab.psychophysics.statistics.group import (
    GroupScore,
    ScoreDifference,
    compare_conditions,
    compare_groups,
    group_score,
)
from burrlab.psychophysics.statistics.group_d_prime import GroupDPrime, group_d_prime
from burrlab.psychophysics.statistics.pair_checks import PairCheck, pair_checks
from burrlab.psychophysics.statistics.power import DesignPower, design_power
from burrlab.psychophysics.statistics.published_score import PublishedScore, group_score_from
from burrlab.psychophysics.statistics.selection import SelectionEffect
from burrlab.psychophysics.statistics.subject_tests import SubjectTest
from burrlab.psychophysics.statistics.tost import SignedEquivalence, tost
from burrlab.psychophysics.trial import Interval, Stimulus, Trial

__all__ = [
    "ABX",
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
    "GroupDPrime",
    "GroupScore",
    "Interval",
    "PairCheck",
    "Prediction",
    "Protocol",
    "PsychometricFit",
    "PublishedScore",
    "Rendered",
    "SameDifferent",
    "ScoreDifference",
    "ScoredTask",
    "Seat",
    "SelectionEffect",
    "SignedEquivalence",
    "SimulatedSubject",
    "Sitting",
    "Staircase",
    "Stimulus",
    "SubjectTest",
    "TaskOneTable",
    "TerminalSeat",
    "ThresholdTask",
    "Trial",
    "VolumeBlock",
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
    "weber",
]
