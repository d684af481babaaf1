"""The state of a web page and what keeps it: the newest wish of the user is done, those before it are passed over."""

from __future__ import annotations

import asyncio
import base64
import io
import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.view import page_mouse, page_words
from burrlab.view.camera import Viewpoint
from burrlab.view.page_camera import PRESETS, PageCameras
from burrlab.view.page_source import PageSource
from burrlab.view.scene import Scene

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
_PERIOD = 0.04  # between two looks at what is wished [s]
_PATIENCE = 2.0  # a browser that has not shown a picture by then is not waited for [s]
_REST = 0.3  # after which a picture at rest is drawn once more, smoother [s]
_QUALITY = {False: 80, True: 92}  # of the JPEG pictures, in motion and at rest
_MOST = 2560, 1600  # of a picture [pixel]


class Page:
    """Shows a source's bone in a scene, and says beside it what happens.

    Parameters
    ----------
    server : trame server
        Not yet started.
    source : PageSource
    scene : Scene
        Of the source's bone, off screen.
    surgeon : Viewpoint, optional
        The first preset; default: along the forces of a trace, else from above.
    stereo : bool
        Begin with both eyes side by side.
    """

    def __init__(
        self,
        server: Any,
        source: PageSource,
        scene: Scene,
        *,
        surgeon: Viewpoint | None = None,
        stereo: bool = False,
    ) -> None:
        self.server, self.source, self.scene = server, source, scene
        self.cameras = PageCameras(source, surgeon)
        scene.look(self.cameras.surgeon)
        self.state = server.state
        self._wanted, self._sent, self._clock = 0.0, -1.0, 0.0
        self._draw, self._on_way = True, -_PATIENCE  # since when a picture is on its way
        self._smooth, self._drawn = False, 0.0  # the newest picture, and when
        self._drag = np.zeros(2)
        self._drag_moves, self._wheel = False, 0.0
        self._changed: list[NDArray[np.uint32]] = []  # bricks, and not yet drawn
        self._counts = tuple(-(-n // 8) for n in source.bone.shape)
        first, last = source.span
        self.state.update({
            "title": source.title, "kind": source.kind, "source_state": source.state, "wanted_s": 0.0, "time_s": 0.0,
            "first_s": first, "last_s": last, "step_s": max((last - first) / 4000.0, 1e-3), "playing": False, "speed": 1.0,
            "speeds": list(SPEEDS), "presets": list(PRESETS), "slices": False, "stereo": bool(stereo), "effects": True, "has_effects": source.has_effects,
            "prepared": 0, "problem": "", "numbers": [], "tissues": [], "distances": [], "events": [], "charts": [],
            "values": [], "picture": "", "picture_number": 0,
        })  # fmt: skip
        self.state.change("wanted_s")(self._wish)
        self.state.change("slices")(self._show_slices)
        self.state.change("stereo")(self._show_stereo)
        self.state.change("effects")(self._show_effects)
        self.state.change("playing")(self._play)
        self.state.change("speed")(self._play)
        for name, call in (
            ("drag", self.drag),
            ("wheel", self.wheel),
            ("shown", self.shown),
            ("draw", self.draw),
        ):
            server.trigger(name)(call)
        scene.draw_fast()
        self._show_stereo(self.state.stereo)
        self._advance(0.0)
        self._picture(smooth=True)

    def look(self, preset: str) -> None:
        """Camera as named: surgeon, burr, or along an axis."""
        self.scene.look(self.cameras.viewpoint(preset))
        self._draw = True

    def step(self, ticks: int) -> None:
        """So many ticks on or back [ms, at 1 kHz]."""
        period = self.source.span[1] / max(len(self.source.history.time), 1)
        self._ask(self._wanted + ticks * period)

    def seek(self, part: float) -> None:
        """To that part of the charts' time axis, 0 to 1."""
        first, last = self.source.span
        self._ask(first + min(max(float(part), 0.0), 1.0) * (last - first))

    def go(self, seconds: float) -> None:
        """To a moment [s]."""
        self._ask(float(seconds))

    def drag(self, right: float, up: float, moves: bool) -> None:
        """The mouse went so far, in parts of the picture's height: turns the bone, or moves it."""
        self._drag += float(right), float(up)
        self._drag_moves = bool(moves)

    def wheel(self, steps: float) -> None:
        """The wheel turned; positive is nearer."""
        self._wheel += float(steps)

    def shown(self, width: int = 0, height: int = 0) -> None:
        """A browser shows the newest picture, and says its place's size if that is news."""
        self._on_way = -_PATIENCE
        if width and height:
            size = tuple(int(min(max(n, 64), most)) for n, most in zip((width, height), _MOST, strict=True))
            if size != tuple(self.scene.plotter.window_size):
                self.scene.plotter.window_size = size
                self._draw = True

    def draw(self) -> None:
        """Once more, as for a window of another size."""
        self._draw = True

    async def run(self) -> None:
        """Until it is cancelled."""
        while True:
            begin = time.monotonic()
            try:
                self._turn(begin)
            except Exception as error:  # the page says it; the server goes on
                with self.state as state:
                    state.problem, state.playing = f"{type(error).__name__}: {error}", False
            await asyncio.sleep(max(0.005, _PERIOD - (time.monotonic() - begin)))

    def _turn(self, now: float) -> None:
        source = self.source
        prepared = round(100 * source.prepared)
        if prepared != self.state.prepared:
            with self.state as state:
                state.prepared = prepared
            if prepared == 100:
                self._show_effects(self.state.effects)
        if not self.state.distances and (rows := source.distances()):  # their fields are made meanwhile
            with self.state as state:
                state.distances = rows
        if source.kind == "live":  # every moment for the curves, whatever is drawn of them
            self._changed.append(source.go(now))
        if now - self._on_way < _PATIENCE:
            return
        self._move_camera()
        if source.kind == "replay" and self.state.playing:
            self._wanted += (now - self._clock) * float(self.state.speed)
            self._clock = now
            if self._wanted >= source.span[1]:
                self._ask(source.span[1])
                self.state.playing = False
        with self.state:  # words and picture of one moment arrive together
            if source.kind == "live" or self._wanted != self._sent:
                self._advance(self._wanted)
                self._draw = True
            if self._draw or not (self._smooth or now - self._drawn < _REST):
                self._picture(smooth=not self._draw)
                self._on_way = self._drawn = now

    def _move_camera(self) -> None:
        camera = self.scene.plotter.camera
        if self._drag.any():
            (page_mouse.move if self._drag_moves else page_mouse.turn)(camera, *self._drag)
            self._drag[:], self._draw = 0.0, True
        if self._wheel:
            page_mouse.zoom(camera, self._wheel)
            self._wheel, self._draw = 0.0, True

    def _advance(self, seconds: float) -> None:
        """Bone, burrs and words to a moment."""
        source, scene = self.source, self.scene
        self._changed.append(source.go(seconds))
        self._changed = [np.unique(np.concatenate(self._changed))]
        if len(bricks := self._changed[0]):
            scene.update(source.bone, np.stack(np.unravel_index(bricks, self._counts), axis=1))
        self._changed = []  # not before: what failed is drawn by the next turn
        burrs = source.burrs
        scene.move_burrs(burrs.centers, burrs.on.tolist())
        scene.set_parcels(source.parcels if self.state.effects else None)
        if self.state.slices:
            self._cut()
        self._sent = seconds
        state = self.state
        if state.playing or source.kind == "live":
            state.wanted_s = seconds
        state.time_s, state.source_state = round(source.time, 4), source.state
        state.first_s, state.last_s = source.span
        state.numbers, state.tissues = page_words.numbers(source), page_words.tissues(source.bone)
        state.distances, state.values = source.distances(), page_words.values(source)
        if not state.charts or source.kind == "live":
            state.charts, state.events = page_words.charts(source), page_words.events(source)

    def _picture(self, *, smooth: bool) -> None:
        from PIL import Image

        renderer = self.scene.plotter.renderer
        (renderer.UseFXAAOn if smooth else renderer.UseFXAAOff)()
        self._draw, self._smooth = False, smooth
        data = io.BytesIO()
        Image.fromarray(self.scene.picture()).save(data, "JPEG", quality=_QUALITY[smooth])
        self.state.picture = "data:image/jpeg;base64," + base64.b64encode(data.getvalue()).decode("ascii")
        self.state.picture_number += 1

    def _wish(self, wanted_s: float, **_: Any) -> None:
        value = float(wanted_s)
        if value != self._sent and math.isfinite(value):
            self._wanted, self._clock = value, time.monotonic()

    def _play(self, **_: Any) -> None:
        self._clock = time.monotonic()
        if self.state.playing and self._wanted >= self.source.span[1]:
            self._ask(0.0)

    def _ask(self, seconds: float) -> None:
        first, last = self.source.span
        self._wanted = min(max(seconds, first), last)
        with self.state as state:
            state.wanted_s = self._wanted

    def _show_slices(self, slices: bool, **_: Any) -> None:
        if slices:
            self._cut()
        else:
            self.scene.set_slices(None)
        self._draw = True

    def _show_stereo(self, stereo: bool, **_: Any) -> None:
        self.scene.set_stereo(bool(stereo))
        self._draw = True

    def _show_effects(self, effects: bool, **_: Any) -> None:
        self.scene.set_parcels(self.source.parcels if effects else None)
        self._draw = True

    def _cut(self) -> None:
        self.scene.set_slices(self.cameras.burr_or_middle())
