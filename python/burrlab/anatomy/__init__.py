"""Anatomy: tissues, phantoms, and the distance to what must not be touched."""

from burrlab.common.face import face

__getattr__, __dir__, __all__ = face(__name__, __file__)
