"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.psychophysics.block import Block
from burrlab.psychophysics.hands import drilling_hand, probing_hand
from burrlab.psychophysics.interval import ENDINGS, Rendered, render

__all__ = ["ENDINGS", "Block", "Rendered", "drilling_hand", "probing_hand", "render"]
