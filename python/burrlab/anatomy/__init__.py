"""Anatomy: what is near the burr, and what becomes of it."""

from burrlab.anatomy.report import AnatomyEvent, AnatomyReport, anatomy_report
from burrlab.anatomy.watch import Limits, Watch

__all__ = ["AnatomyEvent", "AnatomyReport", "Limits", "Watch", "anatomy_report"]
