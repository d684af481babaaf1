"""Anatomy: tissues, phantoms, and the distance to what must not be touched."""

from burrlab.anatomy.air_cells import AirCells, Honeycomb
from burrlab.anatomy.dose import Dose
from burrlab.anatomy.event import AnatomyEvent
from burrlab.anatomy.labelled_bone import LabelledBone, labelled_bone
from burrlab.anatomy.labelled_recipe import LabelledRecipe
from burrlab.anatomy.mastoidectomy import BurrPath, mastoidectomy_path
from burrlab.anatomy.phantom import Phantom, temporal_bone
from burrlab.anatomy.report import AnatomyReport
from burrlab.anatomy.target import TargetComparison, compare_with_target
from burrlab.anatomy.tissue_csv import read_tissues, write_tissues
from burrlab.anatomy.tissue_painting import phantom_tissues
from burrlab.anatomy.tissue_table import default_tissues, label_counts
from burrlab.anatomy.watch import Limits, Watch
from burrlab.session.trace_anatomy import anatomy_report

__all__ = [
    "AirCells",
    "AnatomyEvent",
    "AnatomyReport",
    "BurrPath",
    "Dose",
    "Honeycomb",
    "LabelledBone",
    "LabelledRecipe",
    "Limits",
    "Phantom",
    "TargetComparison",
    "Watch",
    "anatomy_report",
    "compare_with_target",
    "default_tissues",
    "label_counts",
    "labelled_bone",
    "mastoidectomy_path",
    "phantom_tissues",
    "read_tissues",
    "temporal_bone",
    "write_tissues",
]
