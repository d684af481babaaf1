"""VTK actors of a scene: surface, burrs, parcels, legend, scale bar, curves, slices."""

import functools
from collections.abc import Iterable, Sequence, Set
from typing import Any

import numpy as np
from matplotlib.font_manager import findfont
from numpy.typing import ArrayLike, NDArray

from burrlab._core import Tissue, VoxelBone
from burrlab.common.check import refuse
from burrlab.view.pictures import PLANES, slice_image
from burrlab.view.surface import BlockPlace, Surface, SurfaceBlock


def configure(thing: Any, **settings: Any) -> Any:
    """Calls setters of a VTK object and returns it: Color=(r, g, b) is SetColor(r, g, b), and
    InterpolationToPhong=() is SetInterpolationToPhong()."""
    for name, value in settings.items():
        getattr(thing, f"Set{name}")(*value if isinstance(value, tuple) else (value,))
    return thing


@functools.cache
def vtk_class(name: str) -> Any:
    """The VTK class of this name."""
    from vtkmodules import vtkCommonCore, vtkCommonDataModel, vtkRenderingCore

    return next(
        getattr(module, name)
        for module in (vtkCommonCore, vtkCommonDataModel, vtkRenderingCore)
        if hasattr(module, name)
    )


def new(name: str, **settings: Any) -> Any:
    """A configured VTK object of the class of this name."""
    return configure(vtk_class(name)(), **settings)


def vtk_array(values: NDArray[Any], name: str | None = None, *, deep: bool = True) -> Any:
    """An array for VTK. Unless `deep`, it shares memory where types allow."""
    from vtkmodules.util.numpy_support import numpy_to_vtk

    array = numpy_to_vtk(np.ascontiguousarray(values), deep=deep)
    return array if name is None else configure(array, Name=name)


def in_all(renderers: Sequence[Any], actor: Any) -> Any:
    """The actor, which now belongs to all the renderers."""
    for renderer in renderers:
        renderer.AddViewProp(actor)
    return actor


def flat_actor(renderer: Any, mesh: Any, **look: Any) -> Any:
    """An actor in pixels, in front of the scene."""
    mapper = new("vtkPolyDataMapper2D", InputData=mesh)
    return in_all([renderer], new("vtkActor2D", Mapper=mapper, Property=new("vtkProperty2D", **look)))


def text_actor(renderer: Any, text: str = "", **look: Any) -> Any:
    """A text in front of the scene."""
    return in_all([renderer], new("vtkTextActor", Input=text, TextProperty=new("vtkTextProperty", **look)))


class Lines:
    """Lines, or filled polygons, through numbered points that move.

    Parameters
    ----------
    cells : iterable of sequence of int
        The points of each line.
    filled : bool
    """

    def __init__(self, cells: Iterable[Sequence[int]], *, filled: bool = False) -> None:
        array, self._points = new("vtkCellArray"), new("vtkPoints")
        for cell in cells:
            array.InsertNextCell(len(cell), cell)
        self.mesh = new("vtkPolyData", Points=self._points, **{"Polys" if filled else "Lines": array})

    def place(self, points: ArrayLike) -> "Lines":
        """Places all points, (n, 2) or (n, 3)."""
        at = np.asarray(points, np.float32)
        self._points.SetData(vtk_array(np.pad(at, ((0, 0), (0, 3 - at.shape[1])))))
        self.mesh.Modified()
        return self


def polydata(block: SurfaceBlock, palette: NDArray[np.uint8]) -> Any:
    """A block as vtkPolyData with normals and colours. Arrays are shared, not copied, where types allow."""
    cells = new("vtkCellArray")
    cells.SetData(3, vtk_array(block.triangles.ravel()))
    mesh = new("vtkPolyData", Points=new("vtkPoints", Data=vtk_array(block.points, deep=False)), Polys=cells)
    configure(
        mesh.GetPointData(),
        Normals=vtk_array(block.normals, deep=False),
        Scalars=vtk_array(block.colours(palette), "colour"),
    )
    return mesh


class BlockActors:
    """The actors of a surface in some renderers, one a block, so that a changed block is one small upload. A
    block's actor is made when it is first seen.

    Parameters
    ----------
    renderers : sequence of vtkRenderer
    palette : ndarray, shape (tissues, 3), uint8
    """

    def __init__(self, renderers: Sequence[Any], palette: NDArray[np.uint8]) -> None:
        self.renderers, self.palette = renderers, palette
        self.actors: dict[BlockPlace, Any] = {}
        self._stale: set[BlockPlace] = set()  # blocks whose actors are not those of the surface
        self.property = new(
            "vtkProperty",
            InterpolationToPhong=(),
            Ambient=0.16,
            Diffuse=0.86,
            Specular=0.18,
            SpecularPower=18.0,
        )

    def replace(self, blocks: Iterable[BlockPlace]) -> None:
        """Says which blocks changed, including those that are gone; `show` takes them over."""
        self._stale.update(blocks)

    def show(self, surface: Surface, seen: Set[BlockPlace]) -> None:
        """Shows these blocks of the surface and hides the others."""
        for block in self._stale - surface.blocks.keys():
            if (actor := self.actors.pop(block, None)) is not None:
                for renderer in self.renderers:
                    renderer.RemoveActor(actor)
        for block in sorted(self._stale & seen):
            if block not in self.actors:
                actor = new("vtkActor", Mapper=new("vtkPolyDataMapper"), Property=self.property)
                self.actors[block] = in_all(self.renderers, actor)
            self.actors[block].GetMapper().SetInputData(polydata(surface.blocks[block], self.palette))
        self._stale = (self._stale & surface.blocks.keys()) - seen
        for block, actor in self.actors.items():
            actor.SetVisibility(block in seen)


ON, OFF = (0.78, 0.80, 0.84), (0.50, 0.52, 0.56)
_OUTLINE = (0.30, 0.78, 1.0)
_DASHES = 36
_ARM = 0.02  # of a cross, over the distance to the eye
_IN_FRONT = -66000.0  # VTK's depth offset that puts lines before all else


class BurrActors:
    """The burrs of a plotter.

    Parameters
    ----------
    plotter : pyvista.Plotter
    module : module
        pyvista.
    renderers : sequence of vtkRenderer
        Where they are drawn; the plotter's own is the first.
    radii : sequence of float
        [mm]; NaN: not known.
    outline : bool
        Draw the rim of each as a dashed line through everything in front of it; a cross if the radius is not known.
    """

    def __init__(
        self, plotter: Any, module: Any, renderers: Sequence[Any], radii: Sequence[float], *, outline: bool
    ) -> None:
        self.plotter, self.radii, self.balls = plotter, radii, []
        self.centers = np.full((len(self.radii), 3), np.nan)
        for _ in self.radii:
            ball = plotter.add_mesh(
                module.Sphere(radius=1.0, theta_resolution=48, phi_resolution=48), color=OFF, smooth_shading=True,
                ambient=0.15, diffuse=0.7, specular=0.9, specular_power=40, render=False, reset_camera=False,
            )  # fmt: skip
            # hidden until its place is known
            self.balls.append(in_all(renderers[1:], configure(ball, Visibility=False)))
        self.rims = [_Rim(renderers) for _ in self.radii] if outline else []

    def place(self, centers: NDArray[np.float64], on: Sequence[bool] | None, radii: Sequence[float]) -> None:
        """Places the centres (burrs, 3) [mm]. Burrs that do not turn are darker."""
        self.centers, self.radii = centers, radii
        for i, (actor, center, radius) in enumerate(zip(self.balls, centers, radii, strict=True)):
            known = bool(np.isfinite([*center, radius]).all())
            actor.SetVisibility(known)
            if known:
                configure(actor, Position=tuple(center), Scale=radius)
            actor.prop.color = ON if on is None or on[i] else OFF

    def fit(self) -> None:
        """Turns the outlines to the camera."""
        eye = np.array(self.plotter.camera.position)
        for rim, center, radius in zip(self.rims, self.centers, self.radii, strict=bool(self.rims)):
            rim.fit(eye, center, radius)


class _Rim:
    """The rim of a ball as seen from the eye, a dashed circle in front of everything else; or a cross."""

    def __init__(self, renderers: Sequence[Any]) -> None:
        # three points a dash, and a gap of one step
        self.lines = Lines(range(4 * dash, 4 * dash + 3) for dash in range(_DASHES))
        mapper = new(
            "vtkPolyDataMapper", InputData=self.lines.mesh, ResolveCoincidentTopologyToPolygonOffset=(),
            RelativeCoincidentTopologyLineOffsetParameters=(0.0, _IN_FRONT),
        )  # fmt: skip
        look = new("vtkProperty", Lighting=False, Color=_OUTLINE, LineWidth=1.5)
        self.actor = in_all(renderers, new("vtkActor", Mapper=mapper, Property=look, Visibility=False))

    def fit(self, eye: NDArray[np.float64], center: NDArray[np.float64], radius: float) -> None:
        away = eye - center
        distance = float(np.linalg.norm(away))
        visible = bool(np.isfinite(distance)) and not distance <= radius
        self.actor.SetVisibility(visible)
        if not visible:
            return
        away /= distance
        side = np.cross(away, np.eye(3)[np.argmin(np.abs(away))])
        side /= np.linalg.norm(side)
        if np.isnan(radius):
            step = np.arange(2 * _DASHES)[:, None]  # without the gaps
            arm = _ARM * distance * ((step // 4 + np.minimum(step % 4, 2) / 2) * 4 / _DASHES - 1.0)
            self.lines.place(center + np.vstack([arm * side, arm * np.cross(away, side)]))
            return
        turn = np.linspace(0.0, 2 * np.pi, 4 * _DASHES, endpoint=False)[:, None]
        share = radius / distance
        around = np.cos(turn) * side + np.sin(turn) * np.cross(away, side)
        self.lines.place(center + radius * share * away + radius * np.sqrt(1 - share**2) * around)


FIELDS = ("position", "radius", "dust", "blood", "water")
_COLOURS = {"dust": (240, 226, 200), "blood": (168, 12, 18), "water": (150, 200, 236)}
_STRENGTH = {"dust": 1.0, "blood": 3.0, "water": 0.5}  # blood colours what it mixes with, water barely


def parcel_colours(parcels: NDArray[np.void]) -> NDArray[np.uint8]:
    """Red, green, blue of every parcel, (n, 3): the mean of its contents, blood weighing most.

    Raises
    ------
    ValueError
        If the array has no fields position, radius, dust, blood and water.
    """
    missing = [name for name in FIELDS if name not in (parcels.dtype.names or ())]
    refuse(missing, f"parcels must have the fields {', '.join(FIELDS)}; {', '.join(missing)} is missing")
    weights = np.stack([_STRENGTH[name] * parcels[name].astype(float) for name in _COLOURS], axis=1)
    total = weights.sum(axis=1, keepdims=True)
    weights = np.divide(weights, total, out=np.full_like(weights, 1 / 3), where=total > 0)
    return np.asarray(np.rint(weights @ np.array(list(_COLOURS.values()), float)), np.uint8)


#: A disc that is darker towards its rim, like a ball lit from the eye.
_BALL = """//VTK::Color::Impl
float away = dot(offsetVCVSOutput.xy, offsetVCVSOutput.xy);
if (away > 1.0) discard;
float facing = 0.4 + 0.6 * sqrt(1.0 - away);
ambientColor *= facing;
diffuseColor *= facing;
"""


class ParcelActor:
    """Dust, blood and water as shaded discs that face the eye, so that 20 000 cost one upload."""

    def __init__(self, renderers: Sequence[Any]) -> None:
        kind = "vtkPointGaussianMapper"
        # scale of the shape around a disc of radius 1; before VTK 9.6 a triangle
        bound = {"BoundScale": 1.0} if hasattr(vtk_class(kind), "SetBoundScale") else {"TriangleScale": 2.0}
        self.mapper = new(
            kind, ScaleArray="radius", ScaleFactor=1.0, Emissive=False, SplatShaderCode=_BALL, **bound
        )
        self.actor = in_all(renderers, new("vtkActor", Mapper=self.mapper, Visibility=False))

    def replace(self, parcels: NDArray[np.void] | None) -> None:
        """Draws these parcels instead; None or an empty array: nothing."""
        self.actor.SetVisibility(parcels is not None and len(parcels) > 0)
        if parcels is not None:
            colours = vtk_array(parcel_colours(parcels))
            position, radius = (vtk_array(parcels[name].astype(np.float32), name) for name in FIELDS[:2])
            mesh = new("vtkPolyData", Points=new("vtkPoints", Data=position))
            configure(mesh.GetPointData(), Scalars=colours).AddArray(radius)
            self.mapper.SetInputData(mesh)


_TEXT = (0.92, 0.93, 0.95)


def shown_tissues(bone: VoxelBone, surface: Surface) -> list[Tissue]:
    """The tissues that hold bone and are critical or at the surface."""
    at_surface = set().union(*(np.unique(block.tissues).tolist() for block in surface.blocks.values()))
    return [
        tissue
        for number, tissue in enumerate(bone.tissues or ())
        if bone.mass_of(number) + bone.removed_of(number) > 0 and (tissue.critical or number in at_surface)
    ]


class Legend:
    """Colour and name of every shown tissue, at the upper left; nothing without tissues."""

    def __init__(self, renderer: Any, bone: VoxelBone, surface: Surface) -> None:
        self.renderer, self.ground, self.rows = renderer, Ground(renderer), []
        for tissue in shown_tissues(bone, surface):
            colour = tuple(part / 255 for part in tissue.colour)
            # a box: the letter has the colour of its background
            box = {"Color": colour, "BackgroundColor": colour, "BackgroundOpacity": 1.0}
            name = tissue.name + (" (critical)" if tissue.critical else "")
            row = (("M", box), (name, {"Color": _TEXT}))
            self.rows.append(
                [text_actor(renderer, text, VerticalJustificationToCentered=(), **look) for text, look in row]
            )

    def fit(self) -> None:
        """Follows the window's size."""
        height = self.renderer.GetSize()[1]
        size = font_size(height)
        pitch, left, widest = 1.6 * size, 1.2 * size, 0.0
        for i, (box, text) in enumerate(self.rows):
            for actor, x in ((box, left), (text, left + 1.7 * size)):
                actor.GetTextProperty().SetFontSize(size)
                actor.SetPosition(x, height - 1.2 * size - (i + 0.5) * pitch)
            bounds = [0.0, 0.0]
            text.GetSize(self.renderer, bounds)
            widest = max(widest, bounds[0])
        if self.rows:
            low = height - 1.2 * size - len(self.rows) * pitch - 0.4 * size
            self.ground.place(0.5 * size, low, left + 2.5 * size + widest, height - 0.6 * size)


def font_size(height: int) -> int:
    """Font size in a view of this height [pixel]."""
    return max(11, int(height / 52))


class Ground:
    """A dark, translucent rectangle behind text, in pixels."""

    def __init__(self, renderer: Any) -> None:
        self.lines = Lines([range(4)], filled=True).place(np.zeros((4, 2)))
        flat_actor(renderer, self.lines.mesh, Color=(0.04, 0.05, 0.07), Opacity=0.62).SetLayerNumber(0)

    def place(self, left: float, low: float, right: float, high: float) -> None:
        """Places its edges."""
        self.lines.place([(left, low), (right, low), (right, high), (left, high)])


class ScaleBar:
    """A bar of a round length, true at the distance of the camera's focus, below any note on the bone."""

    def __init__(self, renderer: Any, note: str = "") -> None:
        self.renderer, self.ground, self.note = renderer, Ground(renderer), note
        self.lines = Lines([(0, 1), (2, 4), (3, 5)]).place(np.zeros((6, 2)))
        self.bar = flat_actor(renderer, self.lines.mesh, Color=_TEXT, LineWidth=2.0)
        self.text = text_actor(renderer, Color=_TEXT, JustificationToCentered=())

    def fit(self, plotter: Any) -> None:
        """Follows the camera."""
        width, height = self.renderer.GetSize()
        camera = plotter.camera
        seen = 2 * camera.distance * np.tan(np.deg2rad(camera.view_angle) / 2)  # [mm] from bottom to top
        length = float(np.clip(round_value(0.22 * width * seen / max(height, 1)), 0.1, 100.0))
        right, low, tick = 0.97 * width, 0.045 * height, 0.008 * height
        left, size = right - length * height / seen, font_size(height)
        self.lines.place([(x, y) for y in (low, low - tick, low + tick) for x in (left, right)])
        configure(
            self.text,
            Input=f"{self.note}\n{length:g} mm".lstrip(),
            Position=((left + right) / 2, low + 1.2 * tick),
        )
        self.text.GetTextProperty().SetFontSize(size)
        self.ground.place(
            left - size, low - 2.4 * tick, right + size, low + 2.4 * tick + (2.6 if self.note else 1.3) * size
        )


_SPAN = 10.0  # of the time axis [s]


class SceneChart:
    """Two small charts, one above the other; hidden until there are values.

    Parameters
    ----------
    plotter : pyvista.Plotter
    module : module
        pyvista.
    """

    def __init__(self, plotter: Any, module: Any) -> None:
        self.charts, self.lines = [], []
        for row, (label, colour) in enumerate((("force [N]", "#4EA5E0"), ("penetration [mm]", "#3CC49A"))):
            chart = module.Chart2D(
                size=(0.30, 0.155),
                loc=(0.008, 0.17 - 0.16 * row),
                x_label="time [s]" if row else "",
                y_label=label,
            )
            chart.background_color = (0.04, 0.05, 0.07, 0.72)
            chart.border_color = (1.0, 1.0, 1.0, 0.0)
            for axis in (chart.x_axis, chart.y_axis):
                axis.label_size = axis.tick_label_size = 11
                axis.grid = False
                axis.pen.color = axis.tick_label_color = _TEXT
                configure(axis.GetLabelProperties(), Color=_TEXT)
                configure(
                    axis.GetTitleProperties(), Color=_TEXT, Bold=False, FontFamily=4,  # VTK_FONT_FILE
                    FontFile=findfont("DejaVu Sans"),  # VTK's own draws [ as (
                )  # fmt: skip
            self.lines.append(chart.line([0.0, 1.0], [0.0, 0.0], color=colour, width=1.6))
            chart.visible = False
            plotter.add_chart(chart)
            self.charts.append(chart)

    def replace(self, time: ArrayLike, force: ArrayLike, depth: ArrayLike) -> None:
        """Shows the last ten seconds of these values; hides the charts where there are fewer than two."""
        t = np.asarray(time, float)
        recent = t >= (t[-1] - _SPAN if len(t) else 0.0)
        enough = int(np.count_nonzero(recent)) > 1
        for chart, line, values, least in zip(
            self.charts, self.lines, (force, depth), (0.5, 0.1), strict=True
        ):
            y = np.asarray(values, float)[recent]
            chart.visible = enough and not np.isnan(y).all()
            if chart.visible:
                line.update(t[recent], y)
                chart.x_range = (float(t[recent][0]), float(max(t[-1], t[recent][0] + 1e-3)))
                most = max(least, float(np.nanmax(y, initial=0.0)))
                chart.y_range = (0.0, 1.15 * most)
                mark = round_value(most)  # else VTK shows only the zero in a low chart
                chart.y_axis.tick_locations = [0.0, mark]
                chart.y_axis.tick_labels = ["0", f"{mark:g}"]
            elif enough:  # not recorded: the chart above takes its place
                self.charts[0].loc, self.charts[0].x_label = chart.loc, "time [s]"


def round_value(most: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is at most a positive value."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(power * max(step for step in (1, 2, 5) if step * power <= most * (1 + 1e-12)))


_SHARE = 0.26  # of the slices in the window's width
_BURR, _CROSS, _GROUND, _WORDS = (51, 186, 237), (217, 222, 230), (8, 9, 12), (235, 237, 242)


class SlicePanel:
    """Slices along the three planes, one above the other at the right of a plotter's window; the view makes
    room."""

    def __init__(self, plotter: Any) -> None:
        self.plotter, self.mapper = plotter, new("vtkImageMapper", ColorWindow=255.0, ColorLevel=127.5)
        self.renderer = new("vtkRenderer", Viewport=(1 - _SHARE, 0.0, 1.0, 1.0), Interactive=False)
        self.renderer.AddViewProp(new("vtkActor2D", Mapper=self.mapper))
        plotter.render_window.AddRenderer(self.renderer)
        plotter.renderer.SetViewport(0.0, 0.0, 1 - _SHARE, 1.0)
        self.point = np.zeros(3)  # that the planes go through [mm]
        self.drawn: Any = None  # what the picture shows; None: something else

    def fit(self, bone: VoxelBone, centers: NDArray[np.float64], radii: Sequence[float]) -> None:
        """Follows the window's size, and shows burrs where they meet the planes."""
        from PIL import Image, ImageDraw, ImageFont

        drawn = self.renderer.GetSize(), self.point.tobytes(), centers.tobytes(), tuple(radii)
        if drawn == self.drawn:
            return
        self.drawn = drawn
        width, height = (2 * n for n in self.renderer.GetSize())  # twice as fine, for smooth lines
        sheet, pitch = Image.new("RGB", (width, height)), height // 3
        font = ImageFont.truetype(findfont("DejaVu Sans"), max(20, height // 62))
        for row, (plane, (across, right, up)) in enumerate(PLANES.items()):
            image, panel = slice_image(bone, self.point, plane), Image.new("RGB", (width, pitch), _GROUND)
            left, end, low, top = image.extent
            room = pitch - 2 * font.size  # above the words
            scale = 0.98 * min(width / (end - left), room / (top - low))  # [pixel/mm]
            size = max(round(scale * (end - left)), 1), max(round(scale * (top - low)), 1)
            corner = np.array([(width - size[0]) // 2, (room - size[1]) // 2])
            voxels = Image.fromarray(image.pixels[::-1]).resize(size, Image.Resampling.NEAREST)
            panel.paste(voxels, tuple(corner.tolist()))
            points = np.array([self.point, *centers])[:, [right, up]]
            places = corner + scale * (points - (left, top)) * (1, -1)
            draw = ImageDraw.Draw(panel, "RGBA")
            x, y = places[0].tolist()
            for line in ((corner[0], y, corner[0] + size[0], y), (x, corner[1], x, corner[1] + size[1])):
                draw.line(line, fill=(*_CROSS, 115), width=2)
            for center, radius, middle in zip(centers, radii, places[1:], strict=True):
                cut = scale * image.burr_radius(center, radius) if np.isfinite(center).all() else 0.0
                if cut > 0:
                    draw.ellipse([*(middle - cut), *(middle + cut)], outline=_BURR, width=4)
            words = f"{'xyz'[across]} = {image.position:.1f} mm ({'xyz'[right]} right, {'xyz'[up]} up)"
            draw.text((16, pitch - 1.6 * font.size), words, fill=_WORDS, font=font)
            sheet.paste(panel, (0, row * pitch))
        pixels = np.asarray(sheet.reduce(2))[::-1]
        data = new("vtkImageData", Dimensions=(pixels.shape[1], pixels.shape[0], 1))
        data.GetPointData().SetScalars(vtk_array(pixels.reshape(-1, 3)))
        self.mapper.SetInputData(data)

    def remove(self) -> None:
        """Gives the view the whole window again."""
        self.plotter.render_window.RemoveRenderer(self.renderer)
        self.plotter.renderer.SetViewport(0.0, 0.0, 1.0, 1.0)
