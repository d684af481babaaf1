"""Moved: `burrlab.theory.continuum`."""

from burrlab.theory.continuum import *  # noqa: F403
