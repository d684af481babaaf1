"""Anatomy: tissues, phantoms, and the distance to what must not be touched."""

from burrlab.anatomy.tissue_csv import read_tissues, write_tissues
from burrlab.anatomy.tissue_table import default_tissues, label_counts

__all__ = ["default_tissues", "label_counts", "read_tissues", "write_tissues"]
