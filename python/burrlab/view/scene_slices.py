"""Slices through the three planes, in panels of their own beside the view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone
from burrlab.view.slice_image import PLANES, SliceImage, slice_image

_SHARE = 0.26  # of the window's width
_BURR, _CROSS, _TEXT = (0.2, 0.73, 0.93), (0.85, 0.87, 0.9), (0.92, 0.93, 0.95)


class SlicePanels:
    """Three renderers at the right of a plotter's window; the view makes room."""

    def __init__(self, plotter: Any) -> None:
        self.plotter = plotter
        self.point = np.zeros(3)
        self.panels = [_Panel(plotter, plane, row) for row, plane in enumerate(PLANES)]
        plotter.renderer.SetViewport(0.0, 0.0, 1 - _SHARE, 1.0)

    main_share = 1 - _SHARE  # of the window's width, that the view has left

    def cut(self, bone: VoxelBone, point: ArrayLike) -> None:
        """Slices of the bone through a point [mm]."""
        images = [slice_image(bone, point, plane) for plane in PLANES]
        self.point = np.asarray(point, float)
        for panel, image in zip(self.panels, images, strict=True):
            panel.show(image, self.point)

    def refresh(self, bone: VoxelBone) -> None:
        """The same slices of the bone as it is now."""
        self.cut(bone, self.point)

    def move_burrs(self, centers: NDArray[np.float64], radii: Sequence[float]) -> None:
        """Outlines of the burrs where they meet the planes."""
        for panel in self.panels:
            panel.outline(centers, radii)

    def remove(self) -> None:
        """Gives the view the whole window again."""
        for panel in self.panels:
            self.plotter.render_window.RemoveRenderer(panel.renderer)
        self.plotter.renderer.SetViewport(0.0, 0.0, 1.0, 1.0)


class _Panel:
    def __init__(self, plotter: Any, plane: str, row: int) -> None:
        from vtkmodules.vtkRenderingCore import (
            vtkActor,
            vtkImageActor,
            vtkPolyDataMapper,
            vtkRenderer,
            vtkTextActor,
        )

        self.plane = plane
        self.image: SliceImage | None = None
        self.renderer = vtkRenderer()
        self.renderer.SetViewport(1 - _SHARE, 1 - (row + 1) / 3, 1.0, 1 - row / 3)
        self.renderer.SetBackground(0.03, 0.035, 0.045)
        self.renderer.InteractiveOff()
        self.picture, self.lines, self.text = vtkImageActor(), vtkActor(), vtkTextActor()
        self.circles = vtkActor()
        for actor, colour in ((self.lines, _CROSS), (self.circles, _BURR)):
            actor.SetMapper(vtkPolyDataMapper())
            actor.GetProperty().SetColor(*colour)
            actor.GetProperty().SetLighting(False)
        self.lines.GetProperty().SetOpacity(0.45)
        self.circles.GetProperty().SetLineWidth(2.0)
        for actor in (self.picture, self.lines, self.circles, self.text):
            self.renderer.AddViewProp(actor)
        self.picture.InterpolateOff()
        self.picture.GetMapper().BorderOn()  # whole voxels at the rim, and slices of one row
        self.text.GetTextProperty().SetColor(*_TEXT)
        self.text.GetTextProperty().SetFontSize(max(11, plotter.window_size[1] // 56))
        self.text.SetPosition(8, 6)
        plotter.render_window.AddRenderer(self.renderer)

    def show(self, image: SliceImage, point: NDArray[np.float64]) -> None:
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonDataModel import vtkImageData

        self.image = image
        left, right, bottom, top = image.extent
        rows, columns = image.levels.shape
        data = vtkImageData()
        data.SetDimensions(columns, rows, 1)
        step = (right - left) / columns, (top - bottom) / rows
        data.SetSpacing(*step, 1.0)
        data.SetOrigin(left + step[0] / 2, bottom + step[1] / 2, 0.0)
        data.GetPointData().SetScalars(numpy_to_vtk(image.pixels.reshape(-1, 3), deep=True))
        self.picture.SetInputData(data)
        across, along, up = PLANES[self.plane]
        u, v = float(point[along]), float(point[up])
        self.lines.GetMapper().SetInputData(
            _polylines([np.array([[left, v], [right, v]]), np.array([[u, bottom], [u, top]])])
        )
        self.text.SetInput(
            f"{'xyz'[across]} = {image.position:.1f} mm ({'xyz'[along]} right, {'xyz'[up]} up)"
        )
        camera = self.renderer.GetActiveCamera()
        camera.ParallelProjectionOn()
        middle = (left + right) / 2, (bottom + top) / 2
        camera.SetViewUp(0.0, 1.0, 0.0)
        width, height = self.renderer.GetSize()
        aspect = width / height if height else 1.0
        # the words have a strip of their own below
        strip = min(2.2 * self.text.GetTextProperty().GetFontSize() / max(height, 1), 0.4)
        scale = 0.51 * max((top - bottom) / (1 - strip), (right - left) / aspect)
        camera.SetParallelScale(scale)
        low = middle[1] - scale * strip
        camera.SetFocalPoint(middle[0], low, 0.0)
        camera.SetPosition(middle[0], low, 100.0)
        self.renderer.ResetCameraClippingRange()

    def outline(self, centers: NDArray[np.float64], radii: Sequence[float]) -> None:
        if self.image is None:
            return
        _, along, up = PLANES[self.plane]
        turn = np.linspace(0, 2 * np.pi, 65)
        circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        rings = []
        for center, radius in zip(centers, radii, strict=True):
            cut = self.image.burr_radius(center, radius) if np.isfinite(center).all() else 0.0
            if cut > 0:
                rings.append(np.array([center[along], center[up]]) + cut * circle)
        self.circles.GetMapper().SetInputData(_polylines(rings))


def _polylines(lines: Sequence[NDArray[np.float64]]) -> Any:
    """Lines of (x, y) just in front of the picture."""
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

    points, cells, mesh = vtkPoints(), vtkCellArray(), vtkPolyData()
    for line in lines:
        cells.InsertNextCell(len(line))
        for x, y in line:
            cells.InsertCellPoint(points.InsertNextPoint(float(x), float(y), 0.1))
    mesh.SetPoints(points)
    mesh.SetLines(cells)
    return mesh
