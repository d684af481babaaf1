"""Anatomy: a procedural temporal bone, and what is to be removed from it."""

from burrlab.anatomy.air_cells import AirCells, Honeycomb
from burrlab.anatomy.phantom import Phantom, phantom_tissues, temporal_bone

__all__ = ["AirCells", "Honeycomb", "Phantom", "phantom_tissues", "temporal_bone"]
