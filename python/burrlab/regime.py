"""Moved: `burrlab.theory.closed_forms`."""

from burrlab.theory.closed_forms import *  # noqa: F403
