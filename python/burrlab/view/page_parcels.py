"""Dust, blood and water of a recorded session at its moments, made once from its beginning to its end."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

from burrlab.effects import Effects
from burrlab.effects.offline import effects_of
from burrlab.session.trace import Trace
from burrlab.view.player import TracePlayer

#: What is drawn of a parcel, as finely as it is seen: within 0.03 mm, and shares of 255.
_DTYPE = np.dtype([("position", "f2", 3), ("radius", "f2"), ("dust", "u1"), ("blood", "u1"), ("water", "u1")])
_SUBSTANCES = ("dust", "blood", "water")
_RATE = 20.0  # frames of a second of the trace that are made [Hz]


class ParcelHistory:
    """Frames of a trace's parcels, in bounded memory: where they take more, every second one is given up.

    Parameters
    ----------
    trace : Trace
    effects : Effects
        Made with the trace's initial bone, and without a frame yet; best without a budget.
    memory : float
        For frames [MB].
    """

    def __init__(self, trace: Trace, effects: Effects, *, memory: float = 192.0) -> None:
        self._trace, self._effects, self._memory = trace, effects, memory * 1e6
        self._duration = float(trace.duration)
        self._lock = threading.Lock()
        self._frames: list[NDArray[np.void]] = []  # at the ends of `_every` frames of effects, each
        self._every, self._made = 1, 0

    @property
    def made(self) -> float:
        """Part of the trace, 0 to 1."""
        frames = self._duration * _RATE
        return min(1.0, self._made / frames) if frames else 1.0

    @property
    def bytes(self) -> int:
        """That the kept frames take."""
        with self._lock:
            return sum(frame.nbytes for frame in self._frames)

    def make(self, cancel: threading.Event | None = None) -> bool:
        """All of it; may run in a thread. Returns whether it came to the end."""
        player = TracePlayer(self._trace, every=self._duration + 1.0)  # goes forward only
        size = 0
        for _ in effects_of(player, self._effects, rate=_RATE):
            if cancel is not None and cancel.is_set():
                return False
            self._made += 1
            if self._made % self._every:
                continue
            frame = _drawn(self._effects.parcels)
            with self._lock:
                self._frames.append(frame)
                size += frame.nbytes
                while size > self._memory and len(self._frames) > 1:
                    self._frames, self._every = self._frames[1::2], 2 * self._every
                    size = sum(kept.nbytes for kept in self._frames)
        self._made = max(self._made, round(self._duration * _RATE))
        return True

    def at(self, seconds: float) -> NDArray[np.void] | None:
        """Of the newest kept frame that is not after this time; None where there is none yet."""
        with self._lock:
            i = int(seconds * _RATE / self._every + 1e-6)
            if not 0 < i <= len(self._frames):
                return None
            return self._frames[i - 1]


def _drawn(parcels: NDArray[np.void]) -> NDArray[np.void]:
    frame = np.empty(len(parcels), _DTYPE)
    frame["position"], frame["radius"] = parcels["position"], parcels["radius"]
    whole = np.maximum(sum(parcels[name] for name in _SUBSTANCES), 1)
    for name in _SUBSTANCES:
        frame[name] = np.rint(255.0 * parcels[name] / whole)
    return frame
