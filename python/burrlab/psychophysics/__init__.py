"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.abx import ABX
from burrlab.psychophysics.adaptive import AdaptiveStaircase
from burrlab.psychophysics.constant_stimuli import ConstantStimuli
from burrlab.psychophysics.orders import counterbalanced
from burrlab.psychophysics.psychometric import psychometric_function
from burrlab.psychophysics.psychometric_fit import PsychometricFit
from burrlab.psychophysics.same_different import SameDifferent
from burrlab.psychophysics.staircase import Staircase
from burrlab.psychophysics.trial import Interval, Stimulus, Trial

__all__ = [
    "ABX",
    "AdaptiveStaircase",
    "ConstantStimuli",
    "Interval",
    "PsychometricFit",
    "SameDifferent",
    "Staircase",
    "Stimulus",
    "Trial",
    "counterbalanced",
    "psychometric_function",
]
