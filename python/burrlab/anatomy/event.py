"""Something that happened near a structure, as a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from burrlab.session.watch_rows import KINDS


@dataclass(frozen=True)
class AnatomyEvent:
    """Something that happened near a structure.

    Attributes
    ----------
    kind : {"approach", "touch", "injury", "away"}
    tick : int
        Its index.
    structure : str
    burr : int or None
        None: an injury in ticks that were passed over.
    on : bool
        The burr turned.
    distance : float
        Of the burr's surface [mm]; infinite where nobody looked.
    force : float
        Magnitude of the model's force [N].
    removed : float
        From the structure since the session began, by all burrs [mm^3].
    center : (float, float, float)
        Of the burr [mm].
    """

    kind: str
    tick: int
    structure: str
    burr: int | None
    on: bool
    distance: float
    force: float
    removed: float
    center: tuple[float, float, float]

    @classmethod
    def of(cls, row: np.void, structures: Sequence[str], voxel_volume: float) -> AnatomyEvent:
        """Of a row of a trace's events."""
        burr = int(row["burr"])
        return cls(
            KINDS[int(row["kind"])], int(row["tick"]), structures[int(row["structure"])], None if burr < 0 else burr,
            bool(row["on"]), float(row["distance_mm"]), float(row["force_N"]),
            float(row["removed_levels"]) * (voxel_volume / 255.0), tuple(row["center_mm"].tolist()),
        )  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """For JSON, units in the names; None where there is no number."""
        plain = asdict(self)
        for name, key in (("distance", "distance_mm"), ("force", "force_N"), ("removed", "removed_mm3"),
                          ("center", "center_mm")):  # fmt: skip
            plain[key] = plain.pop(name)
        if not np.isfinite(self.distance):
            plain["distance_mm"] = None
        return plain

    def __str__(self) -> str:
        removed = f"{self.removed:.2g} mm^3 removed in this session"
        if self.burr is None:
            return (
                f"{self.structure} injured up to tick {self.tick}, in ticks that were not followed, {removed}"
            )
        what = {
            "approach": f"{max(self.distance, 0.0):.2g} mm from {self.structure}",
            "touch": f"touches {self.structure}",
            "injury": f"injures {self.structure}, {removed},",
            "away": f"away from {self.structure}",
        }[self.kind]
        return f"burr {self.burr}: {what} at tick {self.tick}"
