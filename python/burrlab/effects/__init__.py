"""Dust, blood, irrigation and a sucker, at 15 to 20 Hz beside a bone that loses mass (docs/effects.md)."""

from burrlab._core import Camera, EffectParameters, Nozzle, Sucker
from burrlab.effects.companion import Companion
from burrlab.effects.effects import Effects
from burrlab.effects.offline import effects_of
from burrlab.effects.report import EffectsReport, SubstanceBalance

__all__ = [
    "Camera",
    "Companion",
    "EffectParameters",
    "Effects",
    "EffectsReport",
    "Nozzle",
    "SubstanceBalance",
    "Sucker",
    "effects_of",
]
