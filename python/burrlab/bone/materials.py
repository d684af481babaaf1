"""The materials of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from burrlab._core import Material

_PAPER = "Agus et al., HAPTICS 2004, section 4.2"
_UNKNOWN = "the paper's f and voxel size are unknown; alpha holds for one drill, burr type and speed"

#: The paper's four materials, read-only. The units [N/mm^2] and [1/ms] and the parabolic f are our choices:
#: the paper states neither them nor its voxel size.
materials: Mapping[str, Material] = MappingProxyType(
    {
        "bone": Material(
            "bone", c_e=2.145, alpha=0.087, source=f"{_PAPER}: fitted, mastoid bone; {_UNKNOWN}"
        ),
        "pettigrew": Material(
            "pettigrew", c_e=1.504, alpha=0.116, source=f"{_PAPER}: fitted, Pettigrew resin; {_UNKNOWN}"
        ),
        "pvc": Material("pvc", c_e=0.462, alpha=0.256, source=f"{_PAPER}: fitted, PVC K70; {_UNKNOWN}"),
        "expert": Material(
            "expert", c_e=1.5, alpha=0.1, source=f"{_PAPER}: set by expert surgeons; {_UNKNOWN}"
        ),
    }
)
