"""Both eyes of a scene, side by side in its window."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from burrlab.view.camera import Viewpoint, eyes
from burrlab.view.scene_labels import ScaleBar

SIZE = (1536, 768)  # of a window for both eyes, unless asked for [pixel]


class StereoEyes:
    """A renderer for each eye in place of a plotter's own one, which goes on holding what is drawn, the camera between
    the eyes that mouse and presets move, and the view's place in the window.

    Legend and curves are left out: both eyes would see them in one plane, that of the focus, across bone which is nearer.
    The scale bar stays, since that plane is where it is true.

    Parameters
    ----------
    plotter : pyvista.Plotter
    note : str
        As of `Scene`.
    """

    def __init__(self, plotter: Any, note: str = "") -> None:
        from vtkmodules.vtkRenderingCore import vtkRenderer

        self.plotter = plotter
        self.separation, self.swap = 62.0, False
        self._shared: dict[int, Any] = {}
        self._shared_at = -1  # VTK's time of the main renderer's list
        self._alone: int | None = None
        main = plotter.renderer
        self.renderers = [vtkRenderer(), vtkRenderer()]  # left half, right half
        for renderer in self.renderers:
            renderer.InteractiveOff()  # the mouse moves the main renderer's camera
            renderer.SetBackground(main.GetBackground())
            renderer.SetBackground2(main.GetBackground2())
            renderer.SetGradientBackground(main.GetGradientBackground())
            for light in main.GetLights():
                renderer.AddLight(light)
            plotter.render_window.AddRenderer(renderer)
        self.scales = [ScaleBar(renderer, note) for renderer in self.renderers]
        self.on = False

    def set(self, separation: float, *, swap: bool = False) -> None:
        """Distance of the eyes for a viewer at 500 mm, scaled to the camera's [mm]; the right eye on the left, for crossed
        eyes. ValueError if the separation is negative or not finite."""
        if not (np.isfinite(separation) and separation >= 0):
            raise ValueError(f"separation must be zero or positive and finite, got {separation}")
        self.separation, self.swap = separation, swap

    @property
    def on(self) -> bool:
        """Whether the eyes are drawn, and not what lies between them."""
        return not self.plotter.renderer.GetDraw()

    @on.setter
    def on(self, on: bool) -> None:
        self.plotter.renderer.SetDraw(not on)
        self._alone = None
        for renderer in self.renderers:
            renderer.SetDraw(on)

    def one_by_one(self, separation: float, *, swap: bool = False) -> Iterator[None]:
        """Shows the left half's eye over the whole view, then the right half's; then all as before. ValueError as `set`."""
        before = self.on, self.separation, self.swap
        try:
            self.set(separation, swap=swap)
            for half in (0, 1):
                self.on, self._alone = True, half
                self.renderers[1 - half].DrawOff()
                yield
        finally:
            self.set(before[1], swap=before[2])
            self.on = before[0]

    def follow(self) -> None:
        """Takes over camera, place and actors; before each drawing."""
        if not self.on:
            return
        main = self.plotter.renderer
        self._share()
        left, low, right, high = main.GetViewport()
        middle = (left + right) / 2
        places = [(left, right)] * 2 if self._alone is not None else [(left, middle), (middle, right)]
        width, height = self.plotter.window_size
        aspect = (places[0][1] - places[0][0]) * width / ((high - low) * height)
        camera = self.plotter.camera
        view = Viewpoint(
            tuple(camera.position), tuple(camera.focal_point), tuple(camera.up), float(camera.view_angle)
        )
        pair = eyes(view, self.separation, aspect)
        for renderer, scale, place, (eye, shift) in zip(
            self.renderers, self.scales, places, pair[::-1] if self.swap else pair, strict=True
        ):
            renderer.SetViewport(place[0], low, place[1], high)
            renderer.SetUseFXAA(main.GetUseFXAA())
            own = renderer.GetActiveCamera()
            own.SetPosition(eye.position)
            own.SetFocalPoint(eye.focus)
            own.SetViewUp(eye.up)
            own.SetViewAngle(eye.angle)
            own.SetWindowCenter(shift, 0.0)
            own.SetClippingRange(camera.clipping_range)
            scale.fit(self.plotter)

    def _share(self) -> None:
        """What the main renderer draws of three dimensions."""
        props = self.plotter.renderer.GetViewProps()
        if props.GetMTime() == self._shared_at:
            return
        self._shared_at = props.GetMTime()
        now = {id(prop): prop for prop in props if prop.IsA("vtkProp3D")}
        for renderer in self.renderers:
            for key in self._shared.keys() - now.keys():
                renderer.RemoveViewProp(self._shared[key])
            for key in now.keys() - self._shared.keys():
                renderer.AddViewProp(now[key])
        self._shared = now
