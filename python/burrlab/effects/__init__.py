"""Dust, blood, irrigation and a sucker, at 15 to 20 Hz beside a bone that loses mass (docs/effects.md)."""

from burrlab.common.face import face

__getattr__, __dir__, __all__ = face(__name__, __file__)
