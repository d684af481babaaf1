"""Dust, blood and water as little spheres, coloured by what they hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FIELDS = ("position", "radius", "dust", "blood", "water")
_COLOURS = {"dust": (240, 226, 200), "blood": (168, 12, 18), "water": (150, 200, 236)}
_STRENGTH = {"dust": 1.0, "blood": 3.0, "water": 0.5}  # blood colours what it mixes with, water barely


def parcel_colours(parcels: NDArray[np.void]) -> NDArray[np.uint8]:
    """Red, green, blue of every parcel, (n, 3): the mean of what it holds, blood weighing most.

    Raises
    ------
    ValueError
        If the array has no fields position, radius, dust, blood and water.
    """
    check_parcels(parcels)
    weights = np.stack([_STRENGTH[name] * parcels[name].astype(float) for name in _COLOURS], axis=1)
    total = weights.sum(axis=1, keepdims=True)
    weights = np.divide(weights, total, out=np.full_like(weights, 1 / 3), where=total > 0)
    mixed: NDArray[np.uint8] = np.rint(weights @ np.array(list(_COLOURS.values()), float)).astype(np.uint8)
    return mixed


def check_parcels(parcels: NDArray[np.void]) -> None:
    """ValueError unless it is an array with the fields that are drawn."""
    names = parcels.dtype.names or ()
    missing = [name for name in FIELDS if name not in names]
    if missing:
        raise ValueError(f"parcels must have the fields {', '.join(FIELDS)}; {', '.join(missing)} is missing")


#: A disc that is darker towards its rim, as a ball lit from the eye.
_BALL = """//VTK::Color::Impl
float away = dot(offsetVCVSOutput.xy, offsetVCVSOutput.xy);
if (away > 1.0) discard;
float facing = 0.4 + 0.6 * sqrt(1.0 - away);
ambientColor *= facing;
diffuseColor *= facing;
"""


class ParcelActor:
    """Points drawn as shaded discs that face the eye, so that 20 000 cost one upload."""

    def __init__(self, renderer: Any) -> None:
        from vtkmodules.vtkRenderingCore import vtkActor, vtkPointGaussianMapper

        self.mapper = vtkPointGaussianMapper()
        self.mapper.SetScaleArray("radius")
        self.mapper.SetScaleFactor(1.0)
        self.mapper.SetEmissive(False)
        # of the shape in which a disc of radius 1 lies; a triangle before VTK 9.6
        bound = getattr(self.mapper, "SetBoundScale", None)
        if bound is not None:
            bound(1.0)
        else:
            self.mapper.SetTriangleScale(2.0)
        self.mapper.SetSplatShaderCode(_BALL)
        self.actor = vtkActor()
        self.actor.SetMapper(self.mapper)
        self.actor.SetVisibility(False)
        renderer.AddActor(self.actor)

    def replace(self, parcels: NDArray[np.void] | None) -> None:
        """Draws these instead; None or an empty array: nothing."""
        if parcels is None or len(parcels) == 0:
            if parcels is not None:
                check_parcels(parcels)
            self.actor.SetVisibility(False)
            return
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonCore import vtkPoints
        from vtkmodules.vtkCommonDataModel import vtkPolyData

        colours = numpy_to_vtk(parcel_colours(parcels), deep=True)
        points = vtkPoints()
        points.SetData(numpy_to_vtk(np.ascontiguousarray(parcels["position"], np.float32), deep=True))
        radii = numpy_to_vtk(np.ascontiguousarray(parcels["radius"], np.float32), deep=True)
        radii.SetName("radius")
        mesh = vtkPolyData()
        mesh.SetPoints(points)
        mesh.GetPointData().AddArray(radii)
        mesh.GetPointData().SetScalars(colours)
        self.mapper.SetInputData(mesh)
        self.actor.SetVisibility(True)
