"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""

from burrlab.common.face import face

__getattr__, __dir__, __all__ = face(__name__, __file__)
