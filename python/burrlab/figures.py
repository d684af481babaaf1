"""Moved: `burrlab.common.figures`."""

from burrlab.common.figures import *  # noqa: F403
