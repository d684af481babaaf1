"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.abx import ABX
from burrlab.psychophysics.adaptive import AdaptiveStaircase
from burrlab.psychophysics.answer_file import AnswerFile
from burrlab.psychophysics.answers import Answer, Answers, read_answers, read_folder
from burrlab.psychophysics.block import Block
from burrlab.psychophysics.constant_stimuli import ConstantStimuli
from burrlab.psychophysics.hands import drilling_hand, probing_hand
from burrlab.psychophysics.interval import ENDINGS, Rendered, render
from burrlab.psychophysics.orders import counterbalanced
from burrlab.psychophysics.protocol import Protocol
from burrlab.psychophysics.protocol_template import template
from burrlab.psychophysics.same_different import SameDifferent
from burrlab.psychophysics.staircase import Staircase
from burrlab.psychophysics.trial import Interval, Stimulus, Trial

__all__ = [
    "ABX",
    "ENDINGS",
    "AdaptiveStaircase",
    "Answer",
    "AnswerFile",
    "Answers",
    "Block",
    "ConstantStimuli",
    "Interval",
    "Protocol",
    "Rendered",
    "SameDifferent",
    "Staircase",
    "Stimulus",
    "Trial",
    "counterbalanced",
    "drilling_hand",
    "probing_hand",
    "read_answers",
    "read_folder",
    "render",
    "template",
]
