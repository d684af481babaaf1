"""What the surgeon sees: surface, scene, pictures, film, page. pyvista is imported only where it is used."""

from burrlab.view.camera import Viewpoint, surgeon_view
from burrlab.view.live import LiveView
from burrlab.view.pictures import depth_map, plot_depth_map, plot_slices
from burrlab.view.player import Burrs, History, TracePlayer
from burrlab.view.scene import Scene
from burrlab.view.surface import Surface, SurfaceBlock, surface_blocks
from burrlab.view.trace_view import TraceView
from burrlab.view.video import write_video

__all__ = [
    "Burrs",
    "History",
    "LiveView",
    "Scene",
    "Surface",
    "SurfaceBlock",
    "TracePlayer",
    "TraceView",
    "Viewpoint",
    "depth_map",
    "plot_depth_map",
    "plot_slices",
    "surface_blocks",
    "surgeon_view",
    "write_video",
]
