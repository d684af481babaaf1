"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.abx import ABX
from burrlab.psychophysics.orders import counterbalanced
from burrlab.psychophysics.same_different import SameDifferent
from burrlab.psychophysics.trial import Interval, Stimulus, Trial

__all__ = ["ABX", "Interval", "SameDifferent", "Stimulus", "Trial", "counterbalanced"]
