"""Moved: `burrlab.bone.specimen`."""

from burrlab.bone.specimen import *  # noqa: F403
