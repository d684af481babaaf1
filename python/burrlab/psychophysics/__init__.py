"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.abx import ABX
from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.d_prime import DPrime, binomial_test, d_prime, score_interval
from burrlab.psychophysics.orders import counterbalanced
from burrlab.psychophysics.pair_checks import PairCheck, pair_checks
from burrlab.psychophysics.rules import rule_of
from burrlab.psychophysics.same_different import SameDifferent
from burrlab.psychophysics.trial import Interval, Stimulus, Trial

__all__ = [
    "ABX",
    "Counts",
    "DPrime",
    "Interval",
    "PairCheck",
    "SameDifferent",
    "Stimulus",
    "Trial",
    "binomial_test",
    "counterbalanced",
    "d_prime",
    "pair_checks",
    "rule_of",
    "score_interval",
]
