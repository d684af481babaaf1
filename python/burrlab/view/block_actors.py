"""Surface blocks as VTK actors, one a block, so that a changed block is one small upload."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.view.surface import Block, Surface, SurfaceBlock


def polydata(block: SurfaceBlock, palette: NDArray[np.uint8]) -> Any:
    """A block as vtkPolyData with normals and colours; its arrays are shared, not copied, where types allow."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

    points = vtkPoints()
    points.SetData(numpy_to_vtk(block.points))
    cells = vtkCellArray()
    cells.SetData(3, numpy_to_vtkIdTypeArray(block.triangles.astype(np.int64).ravel(), deep=True))
    mesh = vtkPolyData()
    mesh.SetPoints(points)
    mesh.SetPolys(cells)
    mesh.GetPointData().SetNormals(numpy_to_vtk(block.normals))
    colours = numpy_to_vtk(block.colours(palette), deep=True)
    colours.SetName("colour")
    mesh.GetPointData().SetScalars(colours)
    return mesh


class BlockActors:
    """The actors of a surface in a renderer.

    Parameters
    ----------
    renderer : vtkRenderer
    palette : ndarray, shape (tissues, 3), uint8
    """

    def __init__(self, renderer: Any, palette: NDArray[np.uint8]) -> None:
        from vtkmodules.vtkRenderingCore import vtkProperty

        self.renderer, self.palette = renderer, palette
        self.actors: dict[Block, Any] = {}
        self.property = vtkProperty()
        self.property.SetInterpolationToPhong()
        self.property.SetAmbient(0.16)
        self.property.SetDiffuse(0.86)
        self.property.SetSpecular(0.18)
        self.property.SetSpecularPower(18.0)

    def replace(self, surface: Surface, blocks: Iterable[Block]) -> None:
        """Takes over these blocks of the surface; those that are gone there go here."""
        from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

        for block in blocks:
            made = surface.blocks.get(block)
            actor = self.actors.get(block)
            if made is None:
                if actor is not None:
                    self.renderer.RemoveActor(self.actors.pop(block))
                continue
            if actor is None:
                actor = self.actors[block] = vtkActor()
                actor.SetMapper(vtkPolyDataMapper())
                actor.SetProperty(self.property)
                self.renderer.AddActor(actor)
            actor.GetMapper().SetInputData(polydata(made, self.palette))
