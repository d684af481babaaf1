"""Anatomy: tissues, phantoms, and the distance to what must not be touched."""

from burrlab.anatomy.dose import Dose
from burrlab.anatomy.event import AnatomyEvent
from burrlab.anatomy.report import AnatomyReport, anatomy_report
from burrlab.anatomy.tissue_csv import read_tissues, write_tissues
from burrlab.anatomy.tissue_table import default_tissues, label_counts
from burrlab.anatomy.watch import Limits, Watch

__all__ = [
    "AnatomyEvent",
    "AnatomyReport",
    "Dose",
    "Limits",
    "Watch",
    "anatomy_report",
    "default_tissues",
    "label_counts",
    "read_tissues",
    "write_tissues",
]
