"""Volumes from files, grey or labelled, and bone made of them."""

from burrlab.volume.cut import cut_block
from burrlab.volume.drilled import DrilledVolume, load_drilled, save_drilled
from burrlab.volume.drilled_recipe import DrilledRecipe
from burrlab.volume.geometry import check_same_geometry, same_geometry
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.read import read_labels, read_volume
from burrlab.volume.recipe import VolumeRecipe
from burrlab.volume.stack import read_stack
from burrlab.volume.volume import Volume
from burrlab.volume.write import write_volume
from burrlab.volume.write_dicom import write_dicom

__all__ = [
    "DrilledRecipe",
    "DrilledVolume",
    "LabelVolume",
    "OccupancyMap",
    "Volume",
    "VolumeRecipe",
    "check_same_geometry",
    "cut_block",
    "load_drilled",
    "read_labels",
    "read_stack",
    "read_volume",
    "same_geometry",
    "save_drilled",
    "write_dicom",
    "write_volume",
]
