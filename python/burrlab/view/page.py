"""The page of a scene: its texts, curves and cameras, and a browser's wishes; page.html lays it out."""

import asyncio
import base64
import contextlib
import io
import time
from collections.abc import Callable
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone
from burrlab.view.actors import round_value
from burrlab.view.camera import UNKNOWN_RADIUS, Viewpoint, approach_view, looking_at, surgeon_view
from burrlab.view.page_source import PageSource
from burrlab.view.scene import Scene

WIDTH, HEIGHT = 1000.0, 100.0  # of the charts' coordinates
_COLUMNS = 500


def top(values: NDArray[np.float64]) -> float:
    """End of an axis from 0 that holds the values: 1, 2 or 5 times a power of ten."""
    largest = float(np.nanmax(values, initial=0.0))
    return 1.0 / round_value(1.0 / largest) if largest > 0.0 else 1.0  # 1/2 and 1/5 are 5 and 2 tenths


def polyline(
    time: NDArray[np.float64], values: NDArray[np.float64], span: tuple[float, float], most: float
) -> str:
    """Points "x,y x,y ..." in a chart of 1000 x 100, y downwards.

    With many ticks each column keeps its least and largest value, so that no peak is lost.

    Parameters
    ----------
    time, values : ndarray, shape (n,)
        Times in order.
    span : (first, last)
        Ends of the time axis.
    most : float
        End of the value axis, which begins at 0.
    """
    inside = (time >= span[0]) & (time <= span[1]) & np.isfinite(values)
    time, values = time[inside], values[inside]
    width = span[1] - span[0]
    if not len(time) or width <= 0:
        return ""
    if len(time) > 2 * _COLUMNS:
        column = np.minimum((_COLUMNS * (time - span[0]) / width).astype(np.int64), _COLUMNS - 1)
        starts = np.flatnonzero(np.diff(column, prepend=-1))
        low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
        time, values = np.repeat(time[starts], 2), np.stack([low, high], axis=1).ravel()
    x = WIDTH * (time - span[0]) / width
    y = HEIGHT * (1.0 - np.clip(values / most, 0.0, 1.0))
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))


def numbers(source: PageSource) -> list[dict[str, str]]:
    """Rows of name, value and unit; none for what is not recorded."""
    rows, burrs = [], source.burrs
    for i, radius in enumerate(burrs.radii):
        which = f" {i + 1}" if len(burrs.radii) > 1 else ""
        known = bool(np.isfinite(burrs.centers[i]).all())
        place = ", ".join(f"{value:.2f}" for value in burrs.centers[i]) if known else "not known"
        state_texts = [] if np.isnan(radius) else [f"R = {radius:g} mm"]
        state_texts += [] if burrs.on is None else ["turns" if burrs.on[i] else "stands"]
        rows += [
            ("force" + which, f"{np.linalg.norm(source.force[i]):.2f}", "N"),
            ("penetration" + which, f"{source.depth[i]:.3f}", "mm"),
            ("burr" + which, ", ".join(state_texts) or "nan", ""),
            ("centre" + which, place, "mm" if known else ""),
        ]
    rows.append(("bone removed", f"{source.bone.removed:.2f}", "mm³"))
    return [{"name": name, "value": value, "unit": unit} for name, value, unit in rows if value != "nan"]


def tissues(bone: VoxelBone) -> list[dict[str, Any]]:
    """Rows of the tissues that are critical or were removed in part."""
    removed = [(tissue, bone.removed_of(number)) for number, tissue in enumerate(bone.tissues or ())]
    return [
        {"name": tissue.name, "colour": "rgb({}, {}, {})".format(*tissue.colour), "removed": f"{volume:.2f}",
         "hurt": tissue.critical and volume > 0}
        for tissue, volume in removed if volume > 0 or tissue.critical
    ]  # fmt: skip


def charts(source: PageSource) -> list[dict[str, Any]]:
    """Force and penetration over time, one line a burr."""
    history, span, rows = source.history, source.span, []
    for name, unit, values in (("force", "N", history.force), ("penetration", "mm", history.depth)):
        if values.shape[1] and not (len(values) and np.isnan(values).all()):
            most = top(values)
            rows.append({
                "name": name, "unit": unit, "most": f"{most:g}",
                "lines": [polyline(history.time, column, span, most) for column in values.T],
            })  # fmt: skip
    return rows


def values(source: PageSource) -> list[list[str]]:
    """Present values of the charts' curves: one text for each chart and burr."""
    return [
        [f"{value:.{places}f}".replace("nan", "-") for value in now]
        for now, places in ((np.linalg.norm(source.force, axis=1), 2), (source.depth, 3))
    ]


def events(source: PageSource) -> list[dict[str, Any]]:
    """Rows of the events, with the place of each mark in the charts."""
    first, last = source.span
    scale = WIDTH / max(last - first, 1e-9)
    return [{**event, "x": round(scale * (event["time_s"] - first), 1)} for event in source.events]


_TURN = 200.0  # across the picture [degree]
_ZOOM = 1.15  # a step of the wheel


def move(camera: Any, right: float, up: float) -> None:
    """Moves a camera across its line of sight, in parts of the picture's height. Bone at the focus follows
    the mouse."""
    position, focus = np.array(camera.position), np.array(camera.focal_point)
    sight = focus - position
    distance = float(np.linalg.norm(sight))
    upwards = np.array(camera.up) / np.linalg.norm(camera.up)
    rightwards = np.cross(sight / distance, upwards)
    height = 2.0 * distance * np.tan(np.deg2rad(camera.view_angle) / 2)
    by = -height * (right * rightwards + up * upwards)
    camera.position, camera.focal_point = tuple(position + by), tuple(focus + by)


_AXES = {
    "+x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "+y": (0, 1, 0),
    "-y": (0, -1, 0),
    "-z": (0, 0, -1),
    "+z": (0, 0, 1),
}
PRESETS = ("surgeon", "burr", *_AXES)


SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
_PERIOD = 0.04  # between two looks at the wishes [s]
_PATIENCE = 2.0  # longest wait for a browser to show a picture [s]
_REST = 0.3  # before a picture at rest is drawn once more, smoother [s]
_QUALITY = {False: 80, True: 92}  # of the JPEG pictures, in motion and at rest
_MOST = 2560, 1600  # of a picture [pixel]


class Page:
    """Shows a source's bone in a scene, with its numbers and events beside it.

    Parameters
    ----------
    server : trame server
        Not yet started.
    source : PageSource
    scene : Scene
        Scene of the source's bone, off screen.
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
        self._surgeon = approach_view(source.bone, source.approach) if surgeon is None else surgeon
        scene.look(self._surgeon)
        self.state = server.state
        self._wanted, self._sent, self._clock = 0.0, -1.0, 0.0
        self._draw, self._on_way = True, -_PATIENCE  # since when a picture is on its way
        self._smooth, self._drawn = False, 0.0  # whether the newest picture is smooth, and its time
        self._changed = np.zeros(0, np.uint32)  # bricks that are not drawn yet
        first, last = source.span
        self.state.update({
            "title": source.title, "kind": source.kind, "source_state": source.state, "wanted_s": 0.0, "time_s": 0.0,
            "first_s": first, "last_s": last, "step_s": max((last - first) / 4000.0, 1e-3), "playing": False, "speed": 1.0,
            "speeds": list(SPEEDS), "presets": list(PRESETS), "slices": False, "stereo": bool(stereo), "effects": True, "has_effects": source.has_effects,
            "prepared": 0, "problem": "", "numbers": [], "tissues": [], "distances": [], "events": [], "charts": [],
            "values": [], "picture": "", "picture_number": 0,
        })  # fmt: skip
        for name, handler in (
            ("wanted_s", self._wish), ("slices", self._switch), ("stereo", self._switch),
            ("effects", self._switch), ("playing", self._play), ("speed", self._play),
        ):  # fmt: skip
            self.state.change(name)(handler)
        for call in (self.drag, self.wheel, self.shown, self.draw):
            server.trigger(call.__name__)(call)
        scene.draw_fast()
        scene.set_stereo(self.state.stereo)
        self._advance(0.0)
        self._picture(smooth=True)

    def look(self, preset: str) -> None:
        """Sets the camera by name: surgeon, burr (once it is known), or along an axis."""
        source, view = self.source, self._surgeon
        if preset == "burr" and source.first_center is not None:
            into = None if source.approach is None else source.approach.axis
            radius = float(np.nan_to_num(source.burrs.radii[0], nan=UNKNOWN_RADIUS))
            view = looking_at(source.first_center, into, 8.0 * radius, 40.0)
        elif preset in _AXES:
            view = surgeon_view(source.bone, axis=_AXES[preset], tilt=0.0)
        self.scene.look(view)
        self._draw = True

    def step(self, ticks: int) -> None:
        """Goes forward by a number of ticks; negative is back."""
        self.go(self._wanted + ticks * (self.source.span[1] / max(len(self.source.history.time), 1)))

    def seek(self, part: float) -> None:
        """Goes to a part of the charts' time axis, 0 to 1."""
        first, last = self.source.span
        self.go(first + part * (last - first))

    def go(self, seconds: float) -> None:
        """Goes to a moment [s], or to the end that is nearer."""
        self._wanted = float(np.clip(seconds, *self.source.span))
        with self.state as state:
            state.wanted_s = self._wanted

    def drag(self, right: float, up: float, moves: bool) -> None:
        """Turns or moves the bone by a way of the mouse, in parts of the picture's height."""
        camera, right, up = self.scene.plotter.camera, float(right), float(up)
        if moves:
            move(camera, right, up)
        else:  # around the focus, as if the bone were dragged
            camera.Azimuth(-_TURN * right)
            camera.Elevation(-_TURN * up)
            camera.OrthogonalizeViewUp()
        self._draw = True

    def wheel(self, steps: float) -> None:
        """Zooms by steps of the wheel; positive is nearer."""
        self.scene.plotter.camera.Dolly(_ZOOM ** float(np.clip(steps, -20.0, 20.0)))
        self._draw = True

    def shown(self, width: int = 0, height: int = 0) -> None:
        """Notes that a browser shows the newest picture, and its size if that has changed."""
        self._on_way = -_PATIENCE
        if width and height:
            size = tuple(int(min(max(n, 64), most)) for n, most in zip((width, height), _MOST, strict=True))
            if size != tuple(self.scene.plotter.window_size):
                self.scene.plotter.window_size = size
                self._draw = True

    def draw(self) -> None:
        """Draws once more, as after a change of the window's size."""
        self._draw = True

    async def run(self) -> None:
        """Serves wishes until it is cancelled."""
        while True:
            begin = time.monotonic()
            try:
                self._turn(begin)
            except Exception as error:  # the page shows the error; the server goes on
                with self.state as state:
                    state.problem, state.playing = f"{type(error).__name__}: {error}", False
            await asyncio.sleep(max(0.005, _PERIOD - (time.monotonic() - begin)))

    def _turn(self, now: float) -> None:
        source, state = self.source, self.state
        with state:  # texts and picture of one moment arrive together
            if (prepared := round(100 * source.prepared)) != state.prepared:
                state.prepared = prepared
                if prepared == 100:
                    self._switch()
            if not state.distances and (rows := source.distances()):  # the fields are made in the background
                state.distances = rows
            if source.kind == "live":  # the curves need every moment, drawn or not
                self._changed = np.union1d(self._changed, source.go(now))
            if now - self._on_way < _PATIENCE:
                return
            if source.kind == "replay" and state.playing:
                self._wanted += (now - self._clock) * float(state.speed)
                self._clock = now
                if self._wanted >= source.span[1]:
                    self.go(source.span[1])
                    state.playing = False
            if source.kind == "live" or self._wanted != self._sent:
                self._advance(self._wanted)
                self._draw = True
            if self._draw or not (self._smooth or now - self._drawn < _REST):
                self._picture(smooth=not self._draw)
                self._on_way = self._drawn = now

    def _advance(self, seconds: float) -> None:
        """Brings bone, burrs and texts to a moment."""
        source, state = self.source, self.state
        self._changed = np.union1d(self._changed, source.go(float(np.clip(seconds, *source.span))))
        source.show_in(self.scene, self._changed, parcels=state.effects)
        self._changed = self._changed[:0]  # only now: after a failure the next turn draws them
        self._cut()
        self._sent = seconds
        if state.playing or source.kind == "live":
            state.wanted_s = seconds
        state.time_s, state.source_state = round(source.time, 4), source.state
        state.first_s, state.last_s = source.span
        state.numbers, state.tissues = numbers(source), tissues(source.bone)
        state.distances, state.values = source.distances(), values(source)
        if not state.charts or source.kind == "live":
            state.charts, state.events = charts(source), events(source)

    def _picture(self, *, smooth: bool) -> None:
        from PIL import Image

        self.scene.plotter.renderer.SetUseFXAA(smooth)
        self._draw, self._smooth = False, smooth
        data = io.BytesIO()
        Image.fromarray(self.scene.picture()).save(data, "JPEG", quality=_QUALITY[smooth])
        self.state.picture = "data:image/jpeg;base64," + base64.b64encode(data.getvalue()).decode("ascii")
        self.state.picture_number += 1

    def _wish(self, wanted_s: float, **_: Any) -> None:
        value = float(wanted_s)
        if value != self._sent and np.isfinite(value):
            self._wanted, self._clock = value, time.monotonic()

    def _play(self, **_: Any) -> None:
        self._clock = time.monotonic()
        if self.state.playing and self._wanted >= self.source.span[1]:
            self.go(0.0)

    def _switch(self, **_: Any) -> None:
        self.scene.set_stereo(bool(self.state.stereo))
        self.scene.set_parcels(self.source.parcels if self.state.effects else None)
        self._cut()
        self._draw = True

    def _cut(self) -> None:
        """Shows slices, if they are wanted, through the first burr's centre, or through the middle of the volume
        until it is known."""
        bone, point = self.source.bone, self.source.first_center
        if point is None:
            point = np.array(bone.origin) + np.array(bone.spacing) * (np.array(bone.shape[::-1]) - 1) / 2
        self.scene.set_slices(point if self.state.slices else None)


def _number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= 1e6  # false for NaN


#: State that a browser may change, with a check of the new value.
WISHES: dict[str, Callable[[Any], bool]] = {
    "wanted_s": _number, "speed": lambda value: _number(value) and value in SPEEDS,
    **dict.fromkeys(("playing", "slices", "stereo", "effects"), lambda value: type(value) is bool),
}  # fmt: skip


def restrict(handler: Any) -> None:
    """Restricts a handler of wslink to the calls that the page makes, with arguments of their kinds; others
    do nothing.

    Otherwise trame would let a browser end the server, and change all that other browsers show, scripts
    included.
    """
    calls = handler.functionMap
    core, change = calls["trame.state.update"]
    _, trigger = calls["trame.trigger"]

    def update(core: Any, changes: Any = (), *_: Any, **__: Any) -> None:
        with contextlib.suppress(TypeError, KeyError):
            change(
                core, [row for row in changes if row["key"] in WISHES and WISHES[row["key"]](row["value"])]
            )

    async def call(core: Any, name: Any = "", arguments: Any = (), *_: Any, **__: Any) -> None:
        with contextlib.suppress(TypeError, ValueError):
            if all(_number(value) or isinstance(value, bool | str) for value in arguments):
                await trigger(core, name, arguments, {})

    ignored = core, lambda *_, **__: None  # reports of trame's page on itself
    handler.functionMap = {
        "trame.state.get": calls["trame.state.get"],
        "trame.state.update": (core, update),
        "trame.trigger": (core, call),
        "trame.lifecycle.update": ignored,
        "trame.error.client": ignored,
    }


def build_layout(page: Page) -> None:
    """Makes the page's template, before the server is started."""
    from trame.ui.vuetify3 import VAppLayout

    config = {
        "theme": {"defaultTheme": "dark"},
        "defaults": {"VBtn": {"variant": "text", "density": "comfortable"}},
    }
    page.state.trame__title = f"burrlab: {page.source.title}"
    for call in (page.look, page.step, page.seek, page.go):
        page.server.trigger(call.__name__)(call)
    with VAppLayout(page.server, vuetify_config=config) as layout:
        layout.root.add_child((files("burrlab.view") / "page.html").read_text("utf-8"))
