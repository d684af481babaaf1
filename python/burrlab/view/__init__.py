"""What the surgeon sees: a trace at any moment, and a web page of it."""

from burrlab.view.player import Burrs, History, TracePlayer

__all__ = ["Burrs", "History", "TracePlayer"]
