"""The scene of a bone in a pyvista plotter: off screen or in a window that Ctrl-C ends, in mono or stereo."""

import contextlib
import ctypes.util
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone
from burrlab.bone.image import checked_point
from burrlab.common.check import check_positive, extra, refuse
from burrlab.common.files import new_file
from burrlab.view.actors import (
    BlockActors,
    BurrActors,
    Legend,
    ParcelActor,
    ScaleBar,
    SceneChart,
    SlicePanel,
    configure,
    new,
)
from burrlab.view.camera import Viewpoint, eyes, surgeon_view
from burrlab.view.surface import Surface, blocks_in_sight, tissue_palette

#: Debian packages for drawing without a screen; either choice is enough.
PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri, or libosmesa6"


def pyvista() -> Any:
    """The module pyvista.

    Raises
    ------
    ImportError
        If it is not installed; the message says how to get it.
    """
    return extra("pyvista", "the view", "viz3d")


def prepare_off_screen() -> None:
    """Chooses how VTK draws without a screen on Linux; on other systems VTK chooses itself.

    Raises
    ------
    OSError
        If there is neither a screen nor a library that draws without one; VTK itself would end the process.
    """
    chosen = os.environ.get("VTK_DEFAULT_OPENGL_WINDOW") or os.environ.get("DISPLAY")
    if chosen or not sys.platform.startswith("linux"):
        return
    kinds = {"EGL": "vtkEGLRenderWindow", "OSMesa": "vtkOSOpenGLRenderWindow"}
    kind = next((kinds[library] for library in kinds if ctypes.util.find_library(library)), "")
    refuse(not kind, f"drawing without a screen needs the Debian packages {PACKAGES}", OSError)
    os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = kind


def check_screen() -> None:
    """OSError if a window would have no screen to open on."""
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    refuse(
        sys.platform.startswith("linux") and not screen,
        "a window needs a screen and there is none: draw to a file (--png, --video) or a page (--web)",
        OSError,
    )


SIZE = (1536, 768)  # of a window for both eyes, unless asked for [pixel]


class StereoEyes:
    """A renderer for each eye, drawn in place of a plotter's own renderer.

    The plotter's renderer still holds the camera between the eyes, and the view's place in the window.

    Legend and curves are left out: both eyes would see them in the plane of the focus, drawn over nearer
    bone. The scale bar stays, since it is true in that plane.

    Parameters
    ----------
    plotter : pyvista.Plotter
        With its lights and background.
    note : str
        As for `Scene`.
    """

    def __init__(self, plotter: Any, note: str = "") -> None:
        self.plotter = plotter
        main = plotter.renderer
        ground = {
            name: getattr(main, f"Get{name}")()
            for name in ("Background", "Background2", "GradientBackground")
        }
        self.renderers = [new("vtkRenderer", **ground) for _ in range(2)]  # left half, right half
        for renderer in self.renderers:
            renderer.InteractiveOff()  # the mouse moves the main renderer's camera
            for light in main.GetLights():
                renderer.AddLight(light)
            plotter.render_window.AddRenderer(renderer)
        self.scales = [ScaleBar(renderer, note) for renderer in self.renderers]

    def turn(self, on: bool, separation: float, swap: bool) -> None:
        """Draws the two eyes instead of the view between them, or that view alone."""
        self.on, self.separation, self.swap = on, separation, swap
        self.plotter.renderer.SetDraw(not on)
        for renderer in self.renderers:
            renderer.SetDraw(on)

    def follow(self, viewpoint: Viewpoint) -> None:
        """Takes over the viewpoint between the eyes and the view's place before each drawing."""
        main = self.plotter.renderer
        left, low, right, high = main.GetViewport()
        middle = (left + right) / 2
        width, height = self.plotter.window_size
        aspect = (middle - left) * width / ((high - low) * height)
        clipping = self.plotter.camera.clipping_range
        pair = eyes(viewpoint, self.separation, aspect)
        for renderer, scale, half, (eye, shift) in zip(
            self.renderers, self.scales, ((left, middle), (middle, right)), pair[::-1] if self.swap else pair, strict=True
        ):  # fmt: skip
            configure(renderer, Viewport=(half[0], low, half[1], high), UseFXAA=main.GetUseFXAA())
            configure(
                renderer.GetActiveCamera(), Position=eye.position, FocalPoint=eye.focus, ViewUp=eye.up, ViewAngle=eye.angle,
                WindowCenter=(shift, 0.0), ClippingRange=clipping,
            )  # fmt: skip
            scale.fit(self.plotter)


_SLOW = 0.04  # time of a drawing from which on it is simplified [s]
_AGAIN = 0.5  # time between drawings without a known change: another window may have lain over this one [s]


@contextlib.contextmanager
def held_back() -> Iterator[list[int]]:
    """Raises the KeyboardInterrupt of Ctrl-C and other signals only at the end: raised in a function of pyvista
    that VTK calls, it would be printed and forgotten. Yields the signals that came."""
    came: list[int] = []
    with contextlib.ExitStack() as after:
        if threading.current_thread() is threading.main_thread():
            for name in ("SIGINT", "SIGTERM", "SIGHUP"):
                number = getattr(signal, name, None)
                if number is not None and signal.getsignal(number) is signal.default_int_handler:
                    usual = signal.signal(number, lambda number, _: came.append(number))
                    after.callback(signal.signal, number, usual)
        yield came
    if came:
        raise KeyboardInterrupt


class SceneWindow(contextlib.ExitStack):
    """A context manager that opens the window of a scene, in the main thread.

    Within it only `turn` raises KeyboardInterrupt.

    Parameters
    ----------
    scene : Scene
        Not off screen.
    """

    def __init__(self, scene: "Scene") -> None:
        super().__init__()
        self.scene = scene
        self._seen: tuple[Any, ...] = ()
        self._drawn, self._fast = 0.0, False
        scene._take_sight()
        scene.plotter.show(interactive_update=True, auto_close=False)
        self._events = scene.plotter.iren
        self._events.interactor.EnableRenderOff()  # else each waiting move of the mouse is drawn by itself

    def __enter__(self) -> "SceneWindow":
        self._came = self.enter_context(held_back())
        return self

    def turn(self, *, draw: bool = False) -> bool:
        """Handles mouse, keys and the window's frame since the last call, and draws if they or the caller
        need it. Returns whether the window is still open. KeyboardInterrupt after Ctrl-C."""
        self._events.process_events()
        if self._came:
            raise KeyboardInterrupt
        if self._events.interactor.GetDone():  # q, e, or the cross of the window's frame
            return False
        plotter, now = self.scene.plotter, time.monotonic()
        seen = plotter.camera.GetMTime(), *plotter.window_size
        if draw or seen != self._seen or now - self._drawn > _AGAIN:
            self.scene.render()
            self._drawn = time.monotonic()
            self._seen = plotter.camera.GetMTime(), *plotter.window_size  # drawing sets the camera's range
            if not self._fast and self._drawn - now > _SLOW:
                self._fast = True
                self.scene.draw_fast()
        return True


_MANY = 1_000_000  # triangles from which on hidden blocks are left out: with fewer that saves nothing (ours)
_GROUND, _SKY = (0.055, 0.065, 0.085), (0.20, 0.23, 0.28)


class Scene:
    """The surgeon's view of a bone.

    Parameters
    ----------
    bone : VoxelBone
    radii : sequence of float
        Burr radii [mm]; NaN: not known.
    off_screen : bool
        Draw to pictures only; else in a window.
    size : (width, height)
        Size of window and pictures [pixel].
    level : int
        Occupancy level at the bone's surface, 1 to 255.
    legend : bool
        Name the tissues.
    chart : bool
        Curves of force and depth over time.
    stereo : bool
        Both eyes side by side in the window, as `set_stereo` does.
    outline : bool
        Draw each burr's rim as a dashed line through the bone before it. A surgeon does not see this line.
    note : str
        A few words on the bone, above the scale bar.

    Attributes
    ----------
    plotter : pyvista.Plotter
    surface : Surface
    radii : tuple of float
        Burr radii [mm], taken over by `move_burrs`.

    Raises
    ------
    ValueError
        If a radius is not positive, the size is below 16 pixels, or the level is not from 1 to 255.
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
            check_positive("radii", radius if radius == radius else 1.0)  # NaN
        refuse(min(size) < 16, f"size must be at least 16 pixels each way, got {size[0]} x {size[1]}")
        module = pyvista()
        (prepare_off_screen if off_screen else check_screen)()
        self.bone, self.radii = bone, tuple(float(radius) for radius in radii)
        self.surface = Surface(bone, level=level)
        self.plotter: Any = module.Plotter(
            off_screen=off_screen, window_size=list(size), lighting="none", title="burrlab"
        )
        self.plotter.set_background(_GROUND, top=_SKY)
        # over the left shoulder, a fill from the right, and a weak one from the eye
        for place, strength in (((-0.7, 0.9, 1.0), 0.75), ((1.0, 0.2, 0.6), 0.28), ((0.0, 0.0, 1.0), 0.22)):
            self.plotter.add_light(
                module.Light(position=place, light_type="camera light", intensity=strength)
            )
        main = self.plotter.renderer
        self._eyes = StereoEyes(self.plotter, note)
        renderers = [main, *self._eyes.renderers]
        self.actors = BlockActors(renderers, tissue_palette(bone))
        self.actors.replace(self.surface.blocks)
        self._culls = off_screen
        self._sight: tuple[bool, list[Viewpoint], tuple[int, int]] | None = None
        self._burrs = BurrActors(self.plotter, module, renderers, self.radii, outline=outline)
        self.parcels = ParcelActor(renderers)
        self.panel: SlicePanel | None = None
        self.chart = SceneChart(self.plotter, module) if chart else None
        self.scale = ScaleBar(main, note)
        self.legend = Legend(main, bone, self.surface) if legend else None
        self.look(surgeon_view(bone))
        self.set_stereo(stereo)

    def look(self, viewpoint: Viewpoint) -> None:
        """Sets the camera."""
        camera = self.plotter.camera
        camera.position, camera.focal_point = viewpoint.position, viewpoint.focus
        camera.up, camera.view_angle = viewpoint.up, viewpoint.angle
        self.plotter.renderer.ResetCameraClippingRange()

    @property
    def viewpoint(self) -> Viewpoint:
        """Present viewpoint of the camera."""
        camera = self.plotter.camera
        return Viewpoint(
            tuple(camera.position), tuple(camera.focal_point), tuple(camera.up), float(camera.view_angle)
        )

    def update(self, bone: VoxelBone, bricks: ArrayLike | None = None) -> int:
        """Takes over the changes of a bone; the next picture or `render` draws them.

        Parameters
        ----------
        bone : VoxelBone
            Of the same shape, not to be changed by another thread meanwhile.
        bricks : array_like, shape (n,) or (n, 3), optional
            Changed bricks, by number or place (z, y, x); None: all.

        Returns
        -------
        int
            Number of blocks made anew.

        Raises
        ------
        ValueError
            If bone or bricks have another shape.
        """
        blocks = self.surface.update(bone, bricks)
        self.bone = bone
        self.actors.replace(blocks)
        if blocks:
            self._sight = None
            if self.panel is not None:
                self.panel.drawn = None
        return len(blocks)

    def move_burrs(self, centers: ArrayLike, on: Sequence[bool] | None = None) -> None:
        """Places the burrs' centres, (burrs, 3) [mm]. Burrs that do not turn are darker.

        Raises
        ------
        ValueError
            If there is not a centre for every burr.
        """
        places = np.asarray(centers, float)
        refuse(
            places.shape != (len(self.radii), 3),
            f"centers must have the shape ({len(self.radii)}, 3), got {places.shape}",
        )
        self._burrs.place(places, on, self.radii)

    def set_parcels(self, parcels: NDArray[np.void] | None) -> None:
        """Shows dust, blood and water as the effects give them; None: nothing.

        Raises
        ------
        ValueError
            If the array has no fields position, radius, dust, blood and water.
        """
        self.parcels.replace(parcels)

    def set_slices(self, point: ArrayLike | None) -> None:
        """Shows slices through a point [mm] in three panels beside the view; None removes them.

        Raises
        ------
        ValueError
            If the point is not three finite numbers.
        """
        if point is not None:
            self.panel = self.panel or SlicePanel(self.plotter)
            self.panel.point = checked_point(point, "point")
        elif self.panel is not None:
            self.panel.remove()
            self.panel = None

    def say(self, note: str) -> None:
        """Shows a few words above the scale bar, such as the time."""
        for scale in (self.scale, *self._eyes.scales):
            scale.note = note

    def set_curves(self, time: ArrayLike, force: ArrayLike, depth: ArrayLike) -> None:
        """Shows force [N] and penetration depth [mm] over time [s] in a chart."""
        if self.chart is not None:
            self.chart.replace(time, force, depth)

    def render(self) -> None:
        """Draws once."""
        self._take_sight()
        self.plotter.renderer.ResetCameraClippingRange()
        self._burrs.fit()
        self.scale.fit(self.plotter)
        if self.legend is not None:
            self.legend.fit()
        if self._eyes.on:
            self._eyes.follow(self.viewpoint)
        if self.panel is not None:
            self.panel.fit(self.bone, self._burrs.centers, self.radii)
        self.plotter.render_window.Render()

    def _take_sight(self) -> None:
        """Shows the blocks that the camera sees; of a small bone, and in a window that draws fast, all."""
        blocks = self.surface.blocks
        many = self._culls and sum(len(block.triangles) for block in blocks.values()) > _MANY
        views, size = [self.viewpoint], tuple(self.plotter.window_size)
        if self._eyes.on:
            views = [view for view, _ in eyes(views[0], self._eyes.separation, 1.0)]
        if self._sight == (many, views, size):
            return
        self._sight = many, views, size
        seen = set(blocks)
        if many:
            self.actors.property.BackfaceCullingOn()
            seen = set().union(
                *(blocks_in_sight(blocks, view, size, max(self.bone.spacing)) for view in views)
            )
        self.actors.show(self.surface, seen)

    def set_stereo(self, on: bool, separation: float = 62.0, *, swap: bool = False) -> None:
        """Draws both eyes, each in its half of the view, without legend and curves. Parameters as for
        `stereo_picture`."""
        refuse(
            not (np.isfinite(separation) and separation >= 0),
            f"separation must be zero or positive and finite, got {separation}",
        )
        self._eyes.turn(on, separation, swap)

    def picture(self) -> NDArray[np.uint8]:
        """The present picture of the scene, (height, width, 3)."""
        with held_back():
            self.render()
            return np.asarray(self.plotter.screenshot(return_img=True))

    def screenshot(self, path: str | os.PathLike[str]) -> None:
        """Writes the present picture as PNG.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        _write_png(path, self.picture())

    def stereo_picture(self, separation: float = 62.0, *, swap: bool = False) -> NDArray[np.uint8]:
        """Left and right eye's pictures side by side, (height, 2 width, 3), without legend and curves. Slices
        stand beside both.

        The eyes look in parallel, with shifted frustums. Nothing is skewed, and the focus has no parallax.

        Parameters
        ----------
        separation : float
            Distance of the eyes for a viewer at 500 mm, scaled to the camera's distance [mm].
        swap : bool
            Right eye on the left, for crossed eyes.

        Raises
        ------
        ValueError
            If the separation is negative or not finite.
        """
        before = self._eyes.on, self._eyes.separation, self._eyes.swap
        width, height = self.plotter.window_size
        self.set_stereo(True, separation, swap=swap)
        self.plotter.window_size = 2 * width, height
        try:
            return self.picture()
        finally:
            self.plotter.window_size = width, height
            self._eyes.turn(*before)

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
        """Opens the window until its frame, q or Ctrl-C (KeyboardInterrupt) closes it. The mouse orbits the
        bone."""
        with SceneWindow(self) as window:
            while window.turn():
                time.sleep(1 / 60)

    def draw_fast(self) -> None:
        """Draws without multi-sampling, back faces and what is hidden, in a tenth of a software renderer's
        time."""
        self._culls = True
        self.plotter.render_window.SetMultiSamples(0)
        self.actors.property.BackfaceCullingOn()

    def close(self) -> None:
        """Frees window and memory."""
        self.plotter.close()


def _write_png(path: str | os.PathLike[str], pixels: NDArray[np.uint8]) -> None:
    from PIL import Image

    with new_file(path) as part:
        Image.fromarray(pixels).save(part, format="PNG")
