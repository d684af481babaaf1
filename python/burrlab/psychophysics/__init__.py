"""Psychophysical experiments: design, run, simulate and analyse what people tell apart."""

from burrlab.common.face import face

__getattr__, __dir__, __all__ = face(__name__, __file__)
