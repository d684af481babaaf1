"""What the surgeon sees: surface, scene, pictures, film, player, page. What extras bring is imported where it is used."""

from burrlab.view.player import Burrs, History, TracePlayer

__all__ = ["Burrs", "History", "TracePlayer"]
