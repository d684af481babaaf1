"""What the surgeon sees: surface, scene, pictures, film, page. pyvista is imported only where it is used."""

from burrlab.view.camera import Viewpoint, surgeon_view
from burrlab.view.pictures import depth_map, plot_depth_map, plot_slices
from burrlab.view.scene import Scene
from burrlab.view.surface import Surface, SurfaceBlock, surface_blocks

__all__ = [
    "Scene",
    "Surface",
    "SurfaceBlock",
    "Viewpoint",
    "depth_map",
    "plot_depth_map",
    "plot_slices",
    "surface_blocks",
    "surgeon_view",
]
