"""The scene: bone, burrs, particles, slices, curves, in a pyvista plotter on a screen or off it."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone
from burrlab.view.block_actors import BlockActors
from burrlab.view.burr_actors import BurrActors
from burrlab.view.camera import Viewpoint, surgeon_view
from burrlab.view.parcel_actor import ParcelActor
from burrlab.view.rendering import check_screen, prepare_off_screen, pyvista
from burrlab.view.scene_chart import SceneChart
from burrlab.view.scene_labels import Legend, ScaleBar
from burrlab.view.scene_slices import SlicePanels
from burrlab.view.scene_stereo import StereoEyes
from burrlab.view.scene_window import SceneWindow
from burrlab.view.surface import Surface, tissue_palette

_GROUND, _SKY = (0.055, 0.065, 0.085), (0.20, 0.23, 0.28)


class Scene:
    """What the surgeon sees of a bone.

    Parameters
    ----------
    bone : VoxelBone
    radii : sequence of float
        Of the burrs [mm].
    off_screen : bool
        Draw to pictures only; else in a window.
    size : (width, height)
        Of window and pictures [pixel].
    level : int
        Occupancy level at the bone's surface, 1 to 255.
    legend : bool
        Name the tissues.
    chart : bool
        Curves of force and depth over time.
    stereo : bool
        Both eyes side by side in the window, as `set_stereo` does.
    outline : bool
        Draw each burr's rim as a dashed line through the bone before it. Nobody sees that who drills.
    note : str
        A few words on the bone, above the scale bar.

    Attributes
    ----------
    plotter : pyvista.Plotter
    surface : Surface

    Raises
    ------
    ValueError
        If a radius is not positive, the size is not, or the level is not from 1 to 255.
    ImportError
        If pyvista is not installed.
    OSError
        If there is no screen for a window, or no library to draw without one.
    """

    def __init__(
        self,
        bone: VoxelBone,
        radii: Sequence[float],
        *,
        off_screen: bool = False,
        size: tuple[int, int] = (1024, 768),
        level: int = 128,
        legend: bool = True,
        chart: bool = True,
        stereo: bool = False,
        outline: bool = False,
        note: str = "",
    ) -> None:
        for radius in radii:
            if not (np.isfinite(radius) and radius > 0):
                raise ValueError(f"radii must be positive and finite, got {radius}")
        if min(size) < 16:
            raise ValueError(f"size must be at least 16 pixels each way, got {size[0]} x {size[1]}")
        module = pyvista()
        if off_screen:
            prepare_off_screen()
        else:
            check_screen()
        self.bone, self.radii = bone, tuple(float(radius) for radius in radii)
        self.surface = Surface(bone, level=level)
        self.plotter: Any = module.Plotter(
            off_screen=off_screen, window_size=list(size), lighting="none", title="burrlab"
        )
        self.plotter.set_background(_GROUND, top=_SKY)
        self.actors = BlockActors(self.plotter.renderer, tissue_palette(bone))
        self.actors.replace(self.surface, self.surface.blocks)
        self._burrs = BurrActors(self.plotter, module, self.radii, outline=outline)
        self.parcels = ParcelActor(self.plotter.renderer)
        self.panels: SlicePanels | None = None
        self.chart = SceneChart(self.plotter, module) if chart else None
        self.scale = ScaleBar(self.plotter.renderer, note)
        self.legend = Legend(self.plotter.renderer, bone, self.surface) if legend else None
        self._add_lights(module)
        self._eyes: StereoEyes | None = None
        self.look(surgeon_view(bone))
        if stereo:
            self.set_stereo(True)

    def _add_lights(self, module: Any) -> None:
        # over the left shoulder, a fill from the right, and a weak one from the eye
        for place, strength in (((-0.7, 0.9, 1.0), 0.75), ((1.0, 0.2, 0.6), 0.28), ((0.0, 0.0, 1.0), 0.22)):
            light = module.Light(position=place, light_type="camera light", intensity=strength)
            self.plotter.add_light(light)

    def look(self, viewpoint: Viewpoint) -> None:
        """Sets the camera."""
        camera = self.plotter.camera
        camera.position, camera.focal_point = viewpoint.position, viewpoint.focus
        camera.up, camera.view_angle = viewpoint.up, viewpoint.angle
        self.plotter.renderer.ResetCameraClippingRange()

    @property
    def viewpoint(self) -> Viewpoint:
        """Of the camera now."""
        camera = self.plotter.camera
        return Viewpoint(
            tuple(camera.position), tuple(camera.focal_point), tuple(camera.up), float(camera.view_angle)
        )

    def update(self, bone: VoxelBone, bricks: ArrayLike | None = None) -> int:
        """Takes over what changed of a bone; not drawn before the next picture or `render`.

        Parameters
        ----------
        bone : VoxelBone
            Of the same shape, not to be changed by another thread meanwhile.
        bricks : array_like, shape (n,) or (n, 3), optional
            That changed, by number or place (z, y, x); None: all.

        Returns
        -------
        int
            Blocks that were made anew.

        Raises
        ------
        ValueError
            If bone or bricks have another shape.
        """
        blocks = self.surface.update(bone, bricks)
        self.bone = bone
        self.actors.replace(self.surface, blocks)
        if self.panels is not None and blocks:
            self.panels.refresh(bone)
        return len(blocks)

    def move_burrs(self, centers: ArrayLike, on: Sequence[bool] | None = None) -> None:
        """Puts the burrs' centres, (burrs, 3) [mm]; those that do not turn are darker.

        Raises
        ------
        ValueError
            If there is not a centre for every burr.
        """
        places = np.asarray(centers, float)
        if places.shape != (len(self.radii), 3):
            raise ValueError(f"centers must have the shape ({len(self.radii)}, 3), got {places.shape}")
        self._burrs.place(places, on)
        if self.panels is not None:
            self.panels.move_burrs(places, self.radii)

    def set_parcels(self, parcels: NDArray[np.void] | None) -> None:
        """Dust, blood and water as the effects give them; None: nothing.

        Raises
        ------
        ValueError
            If the array has no fields position, radius, dust, blood and water.
        """
        self.parcels.replace(parcels)

    def set_slices(self, point: ArrayLike | None) -> None:
        """Shows slices through a point [mm] in three panels beside the view; None: takes them away.

        Raises
        ------
        ValueError
            If the point is not three finite numbers.
        """
        if point is None:
            if self.panels is not None:
                self.panels.remove()
            self.panels = None
            return
        if self.panels is None:
            self.panels = SlicePanels(self.plotter)
        self.panels.cut(self.bone, point)
        self.panels.move_burrs(self._burrs.centers, self.radii)

    def set_curves(self, time: ArrayLike, force: ArrayLike, depth: ArrayLike) -> None:
        """Force [N] and penetration depth [mm] over time [s], in a chart."""
        if self.chart is not None:
            self.chart.replace(time, force, depth)

    def render(self) -> None:
        """Draws once."""
        self.plotter.renderer.ResetCameraClippingRange()
        self._burrs.fit()
        self.scale.fit(self.plotter)
        if self.legend is not None:
            self.legend.fit()
        if self._eyes is not None:
            self._eyes.follow()
        self.plotter.render_window.Render()

    @property
    def stereo(self) -> bool:
        """Whether both eyes are drawn side by side."""
        return self._eyes is not None and self._eyes.on

    def set_stereo(self, on: bool, separation: float = 62.0, *, swap: bool = False) -> None:
        """Draws both eyes, each in its half of the view, without legend and curves; parameters as of `stereo_picture`."""
        if on:
            self._stereo_eyes().set(separation, swap=swap)
        if self._eyes is not None:
            self._eyes.on = on

    def _stereo_eyes(self) -> StereoEyes:
        if self._eyes is None:
            self._eyes = StereoEyes(self.plotter, self.scale.note)
        return self._eyes

    def picture(self) -> NDArray[np.uint8]:
        """What is seen now, (height, width, 3)."""
        self.render()
        pixels: NDArray[np.uint8] = np.asarray(self.plotter.screenshot(return_img=True))
        return pixels

    def screenshot(self, path: str | os.PathLike[str]) -> None:
        """Writes what is seen now as PNG.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        _write_png(path, self.picture())

    def stereo_picture(self, separation: float = 62.0, *, swap: bool = False) -> NDArray[np.uint8]:
        """Left and right eye's pictures side by side, (height, 2 width, 3), without legend and curves.

        The eyes look in parallel, with shifted frustums, so that nothing is skewed and what lies at the focus
        has no parallax.

        Parameters
        ----------
        separation : float
            Of the eyes, for a viewer at 500 mm; scaled to the camera's distance [mm].
        swap : bool
            Right eye on the left, for crossed eyes.

        Raises
        ------
        ValueError
            If the separation is negative or not finite.
        """
        eyes = self._stereo_eyes()
        pair = [self.picture() for _ in eyes.one_by_one(separation, swap=swap)]
        return np.concatenate(pair, axis=1)

    def stereo_pair(
        self, path: str | os.PathLike[str], separation: float = 62.0, *, swap: bool = False
    ) -> None:
        """Writes `stereo_picture` as PNG.

        Raises
        ------
        ValueError
            If the separation is negative or not finite.
        OSError
            If the file cannot be written.
        """
        _write_png(path, self.stereo_picture(separation, swap=swap))

    def show(self) -> None:
        """Opens the window, to orbit in with the mouse, until it is closed, by its frame, q or Ctrl-C: KeyboardInterrupt."""
        with SceneWindow(self) as window:
            while window.turn():
                time.sleep(1 / 60)

    def draw_fast(self) -> None:
        """Without multi-sampling and the backs of the surface: of a software renderer's time, a quarter is left."""
        self.plotter.render_window.SetMultiSamples(0)
        self.actors.property.BackfaceCullingOn()

    def close(self) -> None:
        """Frees window and memory."""
        self.plotter.close()


def _write_png(path: str | os.PathLike[str], pixels: NDArray[np.uint8]) -> None:
    from PIL import Image

    Image.fromarray(pixels).save(path, format="PNG")
