"""Moved: `burrlab.common.study`."""

from burrlab.common.study import *  # noqa: F403
