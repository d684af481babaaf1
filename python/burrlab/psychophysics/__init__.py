"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.abx import ABX
from burrlab.psychophysics.adaptive import AdaptiveStaircase
from burrlab.psychophysics.constant_stimuli import ConstantStimuli
from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.d_prime import DPrime, binomial_test, d_prime, score_interval
from burrlab.psychophysics.group import (
    GroupScore,
    ScoreDifference,
    compare_conditions,
    compare_groups,
    group_score,
)
from burrlab.psychophysics.group_d_prime import GroupDPrime, group_d_prime
from burrlab.psychophysics.orders import counterbalanced
from burrlab.psychophysics.pair_checks import PairCheck, pair_checks
from burrlab.psychophysics.published_score import PublishedScore, group_score_from
from burrlab.psychophysics.rules import rule_of
from burrlab.psychophysics.same_different import SameDifferent
from burrlab.psychophysics.staircase import Staircase
from burrlab.psychophysics.subject_tests import SubjectTest
from burrlab.psychophysics.trial import Interval, Stimulus, Trial

__all__ = [
    "ABX",
    "AdaptiveStaircase",
    "ConstantStimuli",
    "Counts",
    "DPrime",
    "GroupDPrime",
    "GroupScore",
    "Interval",
    "PairCheck",
    "PublishedScore",
    "SameDifferent",
    "ScoreDifference",
    "Staircase",
    "Stimulus",
    "SubjectTest",
    "Trial",
    "binomial_test",
    "compare_conditions",
    "compare_groups",
    "counterbalanced",
    "d_prime",
    "group_d_prime",
    "group_score",
    "group_score_from",
    "pair_checks",
    "rule_of",
    "score_interval",
]
