"""Burrs as VTK actors: balls, and the outline of what bone hides of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

ON, OFF = (0.78, 0.80, 0.84), (0.50, 0.52, 0.56)
_OUTLINE = (0.30, 0.78, 1.0)
_DASHES = 36
_IN_FRONT = -66000.0  # of VTK's offset of depths: before all else


class BurrActors:
    """The burrs of a plotter.

    Parameters
    ----------
    plotter : pyvista.Plotter
    module : module
        pyvista.
    radii : sequence of float
        [mm]
    outline : bool
        Draw the rim of each as a dashed line through whatever lies before it.
    """

    def __init__(self, plotter: Any, module: Any, radii: Sequence[float], *, outline: bool) -> None:
        self.plotter, self.radii = plotter, tuple(radii)
        self.centers = np.full((len(self.radii), 3), np.nan)
        self.balls = [self._add_ball(module, radius) for radius in self.radii]
        self.rims = [_Rim(plotter.renderer) for _ in self.radii] if outline else []

    def _add_ball(self, module: Any, radius: float) -> Any:
        sphere = module.Sphere(radius=radius, theta_resolution=48, phi_resolution=48)
        actor = self.plotter.add_mesh(
            sphere, color=OFF, smooth_shading=True, ambient=0.15, diffuse=0.7, specular=0.9,
            specular_power=40, render=False, reset_camera=False,
        )  # fmt: skip
        actor.SetVisibility(False)  # until its place is known
        return actor

    def place(self, centers: NDArray[np.float64], on: Sequence[bool] | None) -> None:
        """Puts the centres (burrs, 3) [mm]; those that do not turn are darker."""
        self.centers = centers
        for i, (actor, center) in enumerate(zip(self.balls, centers, strict=True)):
            known = bool(np.isfinite(center).all())
            actor.SetVisibility(known)
            if known:
                actor.SetPosition(*center)
            actor.prop.color = ON if on is None or on[i] else OFF

    def fit(self) -> None:
        """Turns the outlines to the camera."""
        eye = np.array(self.plotter.camera.position)
        for rim, center, radius in zip(self.rims, self.centers, self.radii, strict=bool(self.rims)):
            rim.fit(eye, center, radius)


class _Rim:
    """The circle in which a ball is seen, dashed, before all else."""

    def __init__(self, renderer: Any) -> None:
        from vtkmodules.vtkCommonCore import vtkPoints
        from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
        from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

        self.points, lines, self.mesh = vtkPoints(), vtkCellArray(), vtkPolyData()
        self.points.SetNumberOfPoints(4 * _DASHES)
        for dash in range(_DASHES):  # three points each, and a gap of one step
            lines.InsertNextCell(3)
            for k in range(3):
                lines.InsertCellPoint(4 * dash + k)
        self.mesh.SetPoints(self.points)
        self.mesh.SetLines(lines)
        mapper = vtkPolyDataMapper()
        mapper.SetInputData(self.mesh)
        mapper.SetResolveCoincidentTopologyToPolygonOffset()
        mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0.0, _IN_FRONT)
        self.actor = vtkActor()
        self.actor.SetMapper(mapper)
        look = self.actor.GetProperty()
        look.SetLighting(False)
        look.SetColor(*_OUTLINE)
        look.SetLineWidth(1.5)
        self.actor.SetVisibility(False)
        renderer.AddActor(self.actor)

    def fit(self, eye: NDArray[np.float64], center: NDArray[np.float64], radius: float) -> None:
        away = eye - center
        distance = float(np.linalg.norm(away))
        shown = bool(np.isfinite(distance)) and distance > radius
        self.actor.SetVisibility(shown)
        if not shown:
            return
        away /= distance
        side = np.cross(away, np.eye(3)[np.argmin(np.abs(away))])
        side /= np.linalg.norm(side)
        turn = np.linspace(0.0, 2 * np.pi, 4 * _DASHES, endpoint=False)[:, None]
        share = radius / distance
        ring = center + radius * share * away
        ring = ring + radius * np.sqrt(1 - share**2) * (
            np.cos(turn) * side + np.sin(turn) * np.cross(away, side)
        )
        for i, point in enumerate(ring):
            self.points.SetPoint(i, *point)
        self.points.Modified()
        self.mesh.Modified()
