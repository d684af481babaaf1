"""Volumes from files, grey or labelled, and bone made of them."""

from burrlab.common.face import face

__getattr__, __dir__, __all__ = face(__name__, __file__)
