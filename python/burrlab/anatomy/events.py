"""Results of a watch: tables at known places in a trace, and events that print as a sentence."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import burrlab._core as _core
from burrlab.bone.snapshot import read_dataset
from burrlab.common.check import refuse
from burrlab.common.records import AsDict, Codec, Keys

if TYPE_CHECKING:
    import h5py


GROUP = "watch"
#: Kinds of events, by number.
KINDS = ("approach", "touch", "injury", "away")

# Field of the core and column of the file.
_COLUMNS = {
    "distance": "distance_mm", "force": "force_N", "removed": "removed_levels", "center": "center_mm",
    "closest": "closest_mm", "closest_center": "closest_center_mm", "near_force": "near_force_N",
    "near_peak": "near_peak_N",
}  # fmt: skip


def _renamed(dtype: np.dtype[Any]) -> np.dtype[Any]:
    return np.dtype([(_COLUMNS.get(name, name), dtype[name]) for name in dtype.names or ()])


#: tick, kind, structure and burr by number, on, distance_mm, force_N, removed_levels, center_mm.
EVENT_DTYPE = _renamed(_core.watch_event_dtype)
#: One burr beside one structure (docs/anatomy.md).
DOSE_DTYPE = _renamed(_core.watch_dose_dtype)


@dataclass(frozen=True, eq=False)
class Watched:
    """Results of a watch: `events` (n,) EVENT_DTYPE, `doses` (burrs, structures) DOSE_DTYPE, `removed` levels
    by tissue."""

    events: NDArray[np.void]
    doses: NDArray[np.void]
    removed: NDArray[np.int64]
    gaps: int = 0
    ticks_passed_over: int = 0
    events_lost: int = 0

    @classmethod
    def of(cls, seen: Mapping[str, Any] | None, removed: NDArray[np.int64], burrs: int = 0) -> "Watched":
        """The results of `AnatomyWatch.seen`, bit for bit; without a watch only the levels removed of each tissue."""
        if seen is None:
            return cls(np.zeros(0, EVENT_DTYPE), np.zeros((burrs, 0), DOSE_DTYPE), removed)
        return cls(
            read_only(seen["events"].view(EVENT_DTYPE)), read_only(seen["doses"].view(DOSE_DTYPE)), removed,
            seen["gaps"], seen["ticks_passed_over"], seen["events_lost"],
        )  # fmt: skip

    @property
    def counts(self) -> NDArray[np.uint64]:
        """Gaps, ticks passed over and events lost, in this order."""
        return np.array([self.gaps, self.ticks_passed_over, self.events_lost], np.uint64)


def create_watch(file: "h5py.File", settings: str, burrs: int, tissues: int) -> "dict[str, h5py.Dataset]":
    """Makes the group of a watch and its datasets except `events`."""
    group = file.create_group(GROUP)
    group.create_dataset("settings", data=np.bytes_(settings.encode()))
    structures = len(json.loads(settings)["structures"])
    return {
        "events_recorded": group.create_dataset("events_recorded", data=np.uint64(0)),
        "doses": group.create_dataset("doses", data=np.zeros((burrs, structures), DOSE_DTYPE)),
        "removed_levels": group.create_dataset("removed_levels", data=np.zeros(tissues, np.int64)),
        "counts": group.create_dataset("counts", data=np.zeros(3, np.uint64)),
        "summed": group.create_dataset("summed", data=np.uint8(0)),
    }


def read_watch(file: "h5py.File", burrs: int) -> tuple[dict[str, Any], Watched | None, NDArray[np.void]]:
    """(settings, results if the session came to its end, events); empty without a watch."""
    if GROUP not in file:
        return {}, None, np.zeros(0, EVENT_DTYPE)
    group = file[GROUP]
    settings = json.loads(read_dataset(group, "settings"))
    limits = [row[key] for row in settings["structures"] for key in ("approach_mm", "touch_mm", "injury_mm3")]
    limits.append(settings["hysteresis_mm"])
    refuse(
        not all(isinstance(row["name"], str) for row in settings["structures"])
        or not all(type(limit) in (int, float) and math.isfinite(limit) for limit in limits),
        "its structures must have names and limits",
    )
    refuse(group["events"].dtype != EVENT_DTYPE, "its events have other columns than this format has")
    events = read_only(read_dataset(group, "events", int(read_dataset(group, "events_recorded"))))
    refuse(
        (events["kind"] >= len(KINDS)).any() or (events["structure"] >= len(settings["structures"])).any(),
        "an event is of no kind or structure that it has",
    )
    doses = read_dataset(group, "doses")
    refuse(
        doses.dtype != DOSE_DTYPE or doses.shape != (burrs, len(settings["structures"])),
        "its doses have other columns than this format has",
    )
    if not read_dataset(group, "summed"):
        return settings, None, events
    gaps, passed, lost = (int(n) for n in read_dataset(group, "counts"))
    removed = read_only(read_dataset(group, "removed_levels"))
    refuse(removed.ndim != 1, "what was removed of its structures is no list")
    return settings, Watched(events, read_only(doses), removed, gaps, passed, lost), events


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """The array itself, which now refuses writes."""
    values.flags.writeable = False
    return values


@dataclass(frozen=True)
class AnatomyEvent(AsDict):
    """An event near a structure.

    Attributes
    ----------
    kind : {"approach", "touch", "injury", "away"}
    tick : int
        Tick index.
    structure : str
    burr : int or None
        None: an injury in ticks that were passed over.
    on : bool
        Whether the burr turned.
    distance : float
        Distance of the burr's surface [mm]; infinite if not looked at.
    force : float
        Magnitude of the model's force [N].
    removed : float
        Removed from the structure since the session began, by all burrs [mm^3].
    center : (float, float, float)
        Burr centre [mm].
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
    def of(cls, row: np.void, structures: Sequence[str], voxel_volume: float) -> "AnatomyEvent":
        """The event in a row of a trace's events."""
        burr = int(row["burr"])
        return cls(
            KINDS[int(row["kind"])], int(row["tick"]), structures[int(row["structure"])], None if burr < 0 else burr,
            bool(row["on"]), float(row["distance_mm"]), float(row["force_N"]),
            float(row["removed_levels"]) * (voxel_volume / 255.0), tuple(row["center_mm"].tolist()),
        )  # fmt: skip

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


_UNITS = {"distance": "distance_mm", "force": "force_N", "removed": "removed_mm3", "center": "center_mm"}
#: How JSON names the fields of an event.
EVENT_KEYS: dict[type, Keys] = {
    AnatomyEvent: {_UNITS.get(f.name, f.name): f.name for f in fields(AnatomyEvent)}
}
AnatomyEvent._codec = Codec(keys=EVENT_KEYS)
