"""Anatomy: tissues, phantoms, and distances to critical structures."""

from burrlab.common.face import face

__getattr__, __dir__, __all__ = face(__name__, __file__)
