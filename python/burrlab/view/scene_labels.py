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


def add_legend(plotter: Any, bone: VoxelBone, surface: Surface) -> None:
    """Colour and name of every tissue, at the upper left; nothing without tissues."""
    if bone.tissues is None:
        return
    entries = [
        (tissue.name + (" (critical)" if tissue.critical else ""), [part / 255 for part in tissue.colour])
        for tissue in (bone.tissues[i] for i in shown_tissues(bone, surface))
    ]
    if not entries:
        return
    from vtkmodules.vtkRenderingCore import vtkTextActor

    width, height = plotter.window_size
    size = max(11, height // 48)
    for row, (name, colour) in enumerate(entries):
        for text, place, tone in (("M", 0.016 * width, colour), (name, 0.016 * width + 1.6 * size, _TEXT)):
            actor = vtkTextActor()
            actor.SetInput(text)
            style = actor.GetTextProperty()
            if tone is colour:  # a box: the letter cannot be told from what lies behind it
                style.SetBackgroundColor(*colour)
                style.SetBackgroundOpacity(1.0)
            style.SetFontSize(size)
            style.SetColor(*tone)
            style.SetVerticalJustificationToCentered()
            coordinate = actor.GetPositionCoordinate()
            coordinate.SetCoordinateSystemToNormalizedViewport()
            coordinate.SetValue(place / width, 1 - (0.022 * height + (row + 0.5) * 1.45 * size) / height)
            plotter.renderer.AddViewProp(actor)


class ScaleBar:
    """A bar of a round length, true at the distance of what the camera looks at."""

    def __init__(self, renderer: Any) -> None:
        from vtkmodules.vtkCommonCore import vtkPoints
        from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
        from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D, vtkTextActor

        self.renderer = renderer
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
        self.text.SetInput(f"{length:g} mm")
        self.text.GetTextProperty().SetFontSize(max(11, int(height / 48)))
        self.text.SetPosition((left + right) / 2, low + 1.2 * tick)


def scale_length(most: float) -> float:
    """The longest of the round lengths, 0.1 to 100 mm, that is not above `most` [mm]."""
    return max((length for length in _LENGTHS if length <= most), default=_LENGTHS[0])
