"""The page's cameras, by name."""

from __future__ import annotations

from typing import Any

import numpy as np

from burrlab.view.approach import approach_view
from burrlab.view.camera import Viewpoint, looking_at, surgeon_view
from burrlab.view.page_source import PageSource

_AXES = {
    "+x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "+y": (0, 1, 0),
    "-y": (0, -1, 0),
    "-z": (0, 0, -1),
    "+z": (0, 0, 1),
}
PRESETS = ("surgeon", "burr", *_AXES)


class PageCameras:
    """Viewpoints of a source.

    Parameters
    ----------
    source : PageSource
    surgeon : Viewpoint, optional
        The first one; default: along the forces of a trace, else from above.
    """

    def __init__(self, source: PageSource, surgeon: Viewpoint | None) -> None:
        self.source = source
        approach = source.approach()
        self._into = None if approach is None else approach.axis
        self.surgeon = approach_view(source.bone, approach) if surgeon is None else surgeon

    def viewpoint(self, preset: str) -> Viewpoint:
        """surgeon, burr (once one is known), or along an axis."""
        bone, burrs = self.source.bone, self.source.burrs
        if preset == "burr" and len(burrs.radii) and np.isfinite(burrs.centers[0]).all():
            width = 8.0 * float(burrs.radii[0])
            return looking_at(burrs.centers[0], self._into, width, 40.0)
        if preset in _AXES:
            return surgeon_view(bone, axis=_AXES[preset], tilt=0.0)
        return self.surgeon

    def burr_or_middle(self) -> Any:
        """The first burr's centre, or the middle of the volume until it is known [mm]."""
        centers, bone = self.source.burrs.centers, self.source.bone
        if len(centers) > 0 and bool(np.isfinite(centers[0]).all()):
            return centers[0]
        return np.array(bone.origin) + np.array(bone.spacing) * (np.array(bone.shape[::-1]) - 1) / 2
