"""What names and measures the scene: legend of tissues, scale bar."""

from __future__ import annotations

from typing import Any

import numpy as np

from burrlab._core import VoxelBone
from burrlab.view.surface import Surface

_TEXT = (0.92, 0.93, 0.95)
_LENGTHS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # [mm]


def shown_tissues(bone: VoxelBone, surface: Surface) -> list[int]:
    """Numbers of the tissues that hold bone, critical ones or those at the surface."""
    if bone.tissues is None:
        return []
    at_surface: set[int] = set()
    for block in surface.blocks.values():
        at_surface.update(np.unique(block.tissues).tolist())
    return [
        number
        for number, tissue in enumerate(bone.tissues)
        if bone.mass_of(number) + bone.removed_of(number) > 0 and (tissue.critical or number in at_surface)
    ]


class Legend:
    """Colour and name of every tissue, at the upper left; nothing without tissues."""

    def __init__(self, renderer: Any, bone: VoxelBone, surface: Surface) -> None:
        from vtkmodules.vtkRenderingCore import vtkTextActor

        self.renderer, self.ground, self.rows = renderer, Ground(renderer), []
        table = bone.tissues
        for number in shown_tissues(bone, surface):
            assert table is not None
            tissue, box, text = table[number], vtkTextActor(), vtkTextActor()
            colour = [part / 255 for part in tissue.colour]
            box.SetInput("M")  # a box: the letter cannot be told from what lies behind it
            text.SetInput(tissue.name + (" (critical)" if tissue.critical else ""))
            box.GetTextProperty().SetBackgroundColor(*colour)
            box.GetTextProperty().SetBackgroundOpacity(1.0)
            for actor, tone in ((box, colour), (text, _TEXT)):
                actor.GetTextProperty().SetColor(*tone)
                actor.GetTextProperty().SetVerticalJustificationToCentered()
                renderer.AddViewProp(actor)
            self.rows.append((box, text))

    def fit(self) -> None:
        """Follows the window's size."""
        height = self.renderer.GetSize()[1]
        size = font_size(height)
        pitch, left, widest = 1.6 * size, 1.2 * size, 0.0
        for i, (box, text) in enumerate(self.rows):
            y = height - 1.2 * size - (i + 0.5) * pitch
            for actor, x in ((box, left), (text, left + 1.7 * size)):
                actor.GetTextProperty().SetFontSize(size)
                actor.SetPosition(x, y)
            bounds = [0.0, 0.0]
            text.GetSize(self.renderer, bounds)
            widest = max(widest, bounds[0])
        if self.rows:
            low = height - 1.2 * size - len(self.rows) * pitch
            self.ground.place(0.5 * size, low - 0.4 * size, left + 2.5 * size + widest, height - 0.6 * size)


def font_size(height: int) -> int:
    """Of all words in a view of this height [pixel]."""
    return max(11, int(height / 52))


class Ground:
    """A dark, translucent rectangle behind words, in pixels."""

    def __init__(self, renderer: Any) -> None:
        from vtkmodules.vtkCommonCore import vtkPoints
        from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
        from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D

        self.points, cells, self.mesh = vtkPoints(), vtkCellArray(), vtkPolyData()
        self.points.SetNumberOfPoints(4)
        cells.InsertNextCell(4)
        for i in range(4):
            self.points.SetPoint(i, 0.0, 0.0, 0.0)
            cells.InsertCellPoint(i)
        self.mesh.SetPoints(self.points)
        self.mesh.SetPolys(cells)
        mapper = vtkPolyDataMapper2D()
        mapper.SetInputData(self.mesh)
        actor = vtkActor2D()
        actor.SetMapper(mapper)
        actor.GetProperty().SetColor(0.04, 0.05, 0.07)
        actor.GetProperty().SetOpacity(0.62)
        actor.SetLayerNumber(0)
        renderer.AddViewProp(actor)

    def place(self, left: float, low: float, right: float, high: float) -> None:
        """Its edges."""
        for i, (x, y) in enumerate(((left, low), (right, low), (right, high), (left, high))):
            self.points.SetPoint(i, x, y, 0.0)
        self.points.Modified()
        self.mesh.Modified()


class ScaleBar:
    """A bar of a round length, true at the distance of what the camera looks at; above it a note on the bone, if there is one."""

    def __init__(self, renderer: Any, note: str = "") -> None:
        from vtkmodules.vtkCommonCore import vtkPoints
        from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
        from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D, vtkTextActor

        self.renderer, self.ground, self.note = renderer, Ground(renderer), note
        self.points, lines, self.mesh = vtkPoints(), vtkCellArray(), vtkPolyData()
        self.points.SetNumberOfPoints(6)
        for a, b in ((0, 1), (2, 3), (4, 5)):
            lines.InsertNextCell(2)
            lines.InsertCellPoint(a)
            lines.InsertCellPoint(b)
        self.mesh.SetPoints(self.points)
        self.mesh.SetLines(lines)
        mapper = vtkPolyDataMapper2D()
        mapper.SetInputData(self.mesh)
        self.bar, self.text = vtkActor2D(), vtkTextActor()
        self.bar.SetMapper(mapper)
        self.bar.GetProperty().SetColor(*_TEXT)
        self.bar.GetProperty().SetLineWidth(2.0)
        self.text.GetTextProperty().SetColor(*_TEXT)
        self.text.GetTextProperty().SetJustificationToCentered()
        renderer.AddViewProp(self.bar)
        renderer.AddViewProp(self.text)

    def fit(self, plotter: Any) -> None:
        """Follows the camera."""
        width, height = self.renderer.GetSize()
        camera = plotter.camera
        seen = 2 * camera.distance * np.tan(np.deg2rad(camera.view_angle) / 2)  # [mm] from bottom to top
        length = scale_length(0.22 * width * seen / max(height, 1))
        pixels = length * height / seen
        right, low, tick = 0.97 * width, 0.045 * height, 0.008 * height
        left = right - pixels
        for i, place in enumerate((
            (left, low), (right, low), (left, low - tick), (left, low + tick), (right, low - tick), (right, low + tick)
        )):  # fmt: skip
            self.points.SetPoint(i, *place, 0.0)
        self.points.Modified()
        self.mesh.Modified()
        self.text.SetInput(f"{self.note}\n{length:g} mm".lstrip())
        size = font_size(height)
        self.text.GetTextProperty().SetFontSize(size)
        self.text.SetPosition((left + right) / 2, low + 1.2 * tick)
        self.ground.place(
            left - size, low - 2.4 * tick, right + size, low + 2.4 * tick + (2.6 if self.note else 1.3) * size
        )


def scale_length(most: float) -> float:
    """The longest of the round lengths, 0.1 to 100 mm, that is not above `most` [mm]."""
    return max((length for length in _LENGTHS if length <= most), default=_LENGTHS[0])
