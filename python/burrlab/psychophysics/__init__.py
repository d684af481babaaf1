"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.abx import ABX
from burrlab.psychophysics.block import Block
from burrlab.psychophysics.cues import Cues, closed_form_cues, interval_cues, rendered_cues
from burrlab.psychophysics.hands import drilling_hand, probing_hand
from burrlab.psychophysics.interval import ENDINGS, Rendered, render
from burrlab.psychophysics.orders import counterbalanced
from burrlab.psychophysics.rehearsal import rehearse, teach
from burrlab.psychophysics.same_different import SameDifferent
from burrlab.psychophysics.simulated_subject import SimulatedSubject
from burrlab.psychophysics.task_one import TaskOneTable, task1_table
from burrlab.psychophysics.trial import Interval, Stimulus, Trial

__all__ = [
    "ABX",
    "ENDINGS",
    "Block",
    "Cues",
    "Interval",
    "Rendered",
    "SameDifferent",
    "SimulatedSubject",
    "Stimulus",
    "TaskOneTable",
    "Trial",
    "closed_form_cues",
    "counterbalanced",
    "drilling_hand",
    "interval_cues",
    "probing_hand",
    "rehearse",
    "render",
    "rendered_cues",
    "task1_table",
    "teach",
]
