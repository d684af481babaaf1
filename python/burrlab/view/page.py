"""The state of a web page and what keeps it: the newest wish of the user is done, those before it are passed over."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

import numpy as np

from burrlab.view.camera import Viewpoint, surgeon_view
from burrlab.view.page_chart import polyline, top
from burrlab.view.page_source import PageSource
from burrlab.view.scene import Scene

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
PRESETS = ("surgeon", "burr", "front", "side", "above")
_PERIOD = 0.05  # between two looks at what is wished [s]
_AGAIN = 3  # times that a picture is asked for once more: VTK's encoder may be a picture behind


class Page:
    """Shows a source's bone in a scene, and says beside it what happens.

    Parameters
    ----------
    server : trame server
        Not yet started.
    source : PageSource
    scene : Scene
        Of the source's bone, off screen.
    """

    def __init__(self, server: Any, source: PageSource, scene: Scene) -> None:
        self.server, self.source, self.scene = server, source, scene
        self.state = server.state
        self.view: Any = None  # the remote view, once the layout is made
        self._wanted, self._sent, self._clock = 0.0, -1.0, 0.0
        self._again, self._stale = 0, True
        self._counts = tuple(-(-n // 8) for n in source.bone.shape)
        first, last = source.span
        self.state.update({
            "title": source.title, "kind": source.kind, "source_state": source.state, "wanted_s": 0.0, "time_s": 0.0,
            "first_s": first, "last_s": last, "step_s": max((last - first) / 4000.0, 1e-3), "playing": False, "speed": 1.0,
            "speeds": list(SPEEDS), "presets": list(PRESETS), "slices": False, "prepared": 0, "problem": "",
            "numbers": [], "tissues": [], "distances": [], "events": [], "charts": [],
        })  # fmt: skip
        self.state.change("wanted_s")(self._wish)
        self.state.change("slices")(self._show_slices)
        self.state.change("playing")(self._play)
        self.state.change("speed")(self._play)
        self._say_events()
        self._advance(0.0)

    def look(self, preset: str) -> None:
        """Camera as named: surgeon, burr, front, side or above."""
        self.scene.look(self._viewpoint(preset))
        self._push()

    def step(self, ticks: int) -> None:
        """So many ticks on or back [ms, at 1 kHz]."""
        period = self.source.span[1] / max(len(self.source.history.time), 1)
        self._ask(self._wanted + ticks * period)

    def seek(self, part: float) -> None:
        """To that part of the charts' time axis, 0 to 1."""
        first, last = self.source.span
        self._ask(first + min(max(float(part), 0.0), 1.0) * (last - first))

    async def run(self) -> None:
        """Until it is cancelled."""
        while True:
            begin = time.monotonic()
            try:
                self._turn(begin)
            except Exception as error:  # the page says it; the server goes on
                with self.state as state:
                    state.problem, state.playing = f"{type(error).__name__}: {error}", False
            await asyncio.sleep(max(0.01, _PERIOD - (time.monotonic() - begin)))

    def _turn(self, now: float) -> None:
        source = self.source
        if source.kind == "replay" and self.state.playing:
            self._wanted += (now - self._clock) * float(self.state.speed)
            self._clock = now
            if self._wanted >= source.span[1]:
                self._ask(source.span[1])
                self.state.playing = False
        if self._stale or source.kind == "live" or self._wanted != self._sent:
            self._stale = False
            self._advance(self._wanted)
            self._push()
        elif self._again:
            self._again -= 1
            self.view.module._vtk_core.InvokeEvent(
                "UpdateEvent"
            )  # sends what was encoded meanwhile, draws nothing
        prepared = round(100 * source.prepared)
        if prepared != self.state.prepared:
            with self.state as state:
                state.prepared = prepared

    def _advance(self, seconds: float) -> None:
        """Bone, burrs and words to a moment; `_push` draws them."""
        source, scene = self.source, self.scene
        bricks = source.go(seconds)
        if len(bricks):
            scene.update(source.bone, np.stack(np.unravel_index(bricks, self._counts), axis=1))
        burrs = source.burrs
        scene.move_burrs(burrs.centers, list(burrs.on))
        if self.state.slices:
            self._cut()
        self._sent = seconds
        with self.state as state:
            if state.playing or source.kind == "live":
                state.wanted_s = seconds
            state.time_s, state.source_state = round(source.time, 4), source.state
            state.first_s, state.last_s = source.span
            state.numbers, state.tissues = self._numbers(), self._tissues()
            state.distances = source.distances()
            if not state.charts or source.kind == "live":
                state.charts = self._charts()

    def _push(self) -> None:
        if self.view is None:
            return
        self.scene.plotter.renderer.ResetCameraClippingRange()
        self.scene.scale.fit(self.scene.plotter)
        self.view.update()
        self._again = _AGAIN

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
        self._push()

    def _cut(self) -> None:
        centers = self.source.burrs.centers
        known = len(centers) > 0 and bool(np.isfinite(centers[0]).all())
        self.scene.set_slices(centers[0] if known else self._middle())

    def _middle(self) -> Any:
        bone = self.source.bone
        return np.array(bone.origin) + np.array(bone.spacing) * (np.array(bone.shape[::-1]) - 1) / 2

    def _viewpoint(self, preset: str) -> Viewpoint:
        bone, burrs = self.source.bone, self.source.burrs
        if preset == "burr" and len(burrs.radii) and np.isfinite(burrs.centers[0]).all():
            return surgeon_view(bone, burrs.centers[0], width=8.0 * float(burrs.radii[0]), tilt=40.0)
        axes = {"front": (0.0, 1.0, 0.0), "side": (-1.0, 0.0, 0.0), "above": (0.0, 0.0, -1.0)}
        if preset in axes:
            return surgeon_view(bone, axis=axes[preset], tilt=0.0)
        return surgeon_view(bone)

    def _numbers(self) -> list[dict[str, str]]:
        source, rows = self.source, []
        force, burrs = source.force, source.burrs
        for i in range(len(burrs.radii)):
            which = f" {i + 1}" if len(burrs.radii) > 1 else ""
            place = ", ".join(f"{value:.2f}" for value in burrs.centers[i])
            turns = "turns" if burrs.on[i] else "stands"
            rows += [
                ("force" + which, f"{np.linalg.norm(force[i]):.2f}", "N"),
                ("penetration" + which, f"{source.depth[i]:.3f}", "mm"),
                ("burr" + which, f"R = {burrs.radii[i]:g} mm, {turns}", ""),
                ("centre" + which, place, "mm"),
            ]
        rows.append(("bone removed", f"{source.bone.removed:.2f}", "mm³"))
        return [{"name": name, "value": value, "unit": unit} for name, value, unit in rows]

    def _tissues(self) -> list[dict[str, Any]]:
        bone = self.source.bone
        if bone.tissues is None:
            return []
        return [
            {"name": tissue.name, "colour": "rgb({}, {}, {})".format(*tissue.colour), "critical": tissue.critical,
             "removed": f"{bone.removed_of(i):.2f}"}
            for i, tissue in enumerate(bone.tissues) if bone.removed_of(i) > 0 or tissue.critical
        ]  # fmt: skip

    def _charts(self) -> list[dict[str, Any]]:
        history, span = self.source.history, self.source.span
        charts = []
        for name, unit, values in (("force", "N", history.force), ("penetration", "mm", history.depth)):
            if not values.shape[1]:
                continue
            most = top(values)
            lines = [polyline(history.time, column, span, most) for column in values.T]
            charts.append({"name": name, "unit": unit, "most": f"{most:g}", "lines": lines})
        return charts

    def _say_events(self) -> None:
        self.state.events = [
            {"time_s": at, "clock": f"{at:.2f} s", "text": text} for at, text in self.source.events
        ]
