"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.abx import ABX
from burrlab.psychophysics.design_size import subjects_needed, trials_needed
from burrlab.psychophysics.equivalence import Equivalence, equivalence
from burrlab.psychophysics.group import (
    GroupScore,
    ScoreDifference,
    compare_conditions,
    compare_groups,
    group_score,
)
from burrlab.psychophysics.group_d_prime import GroupDPrime, group_d_prime
from burrlab.psychophysics.orders import counterbalanced
from burrlab.psychophysics.power import DesignPower, design_power
from burrlab.psychophysics.published_score import PublishedScore, group_score_from
from burrlab.psychophysics.same_different import SameDifferent
from burrlab.psychophysics.subject_tests import SubjectTest
from burrlab.psychophysics.tost import SignedEquivalence, tost
from burrlab.psychophysics.trial import Interval, Stimulus, Trial

__all__ = [
    "ABX",
    "DesignPower",
    "Equivalence",
    "GroupDPrime",
    "GroupScore",
    "Interval",
    "PublishedScore",
    "SameDifferent",
    "ScoreDifference",
    "SignedEquivalence",
    "Stimulus",
    "SubjectTest",
    "Trial",
    "compare_conditions",
    "compare_groups",
    "counterbalanced",
    "design_power",
    "equivalence",
    "group_d_prime",
    "group_score",
    "group_score_from",
    "subjects_needed",
    "tost",
    "trials_needed",
]
