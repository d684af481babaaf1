"""The tables of a protocol, each with its rules."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from burrlab._core import Burr
from burrlab.bounds import shown
from burrlab.psychophysics.design import Design
from burrlab.psychophysics.experiment.block import Block
from burrlab.psychophysics.experiment.design_table import design_of, stimuli_of
from burrlab.psychophysics.experiment.toml_table import Table
from burrlab.psychophysics.experiment.volume_block import VolumeBlock
from burrlab.psychophysics.rules import RULES, RuleName
from burrlab.session.device_text import parse_device
from burrlab.specimen import MOST_VOXELS, unit_vector
from burrlab.volume.geometry import checked_point
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.recipe import VolumeRecipe

_MOST_SUBJECTS = 9999
_LONGEST = 86400.0  # [s], a day: waiting has an end


@dataclass(frozen=True)
class AnalysisSettings:
    """What was settled beforehand about the analysis.

    Attributes
    ----------
    rules : tuple of str
        Decision rules that d' is estimated under.
    delta : float or None
        d' below which two materials count as alike in the equivalence test; None: no such test.
    level : float
        Of the intervals.
    """

    rules: tuple[RuleName, ...] = RULES
    delta: float | None = None
    level: float = 0.95


def subjects_of(table: Table) -> tuple[str, ...]:
    """Labels of the subjects of [experiment]."""
    value = table.value("subjects")
    if type(value) is int:
        if not 1 <= value <= _MOST_SUBJECTS:
            raise table.error(f"subjects must be 1 to {_MOST_SUBJECTS}, or a list of names, got {value}")
        digits = max(2, len(str(value)))
        return tuple(f"{number:0{digits}}" for number in range(1, value + 1))
    if not (isinstance(value, list) and value and all(isinstance(one, str) for one in value)):
        raise table.error(f"subjects must be a number or a list of names, got {shown(value)}")
    _check_labels(table, "a subject", value)
    return tuple(value)


def _check_labels(table: Table, what: str, labels: list[str]) -> None:
    """Names that go into names of files, on any file system."""
    seen: dict[str, str] = {}
    for label in labels:
        if not (label.isascii() and label.isalnum()):
            raise table.error(
                f"{what}'s name must be of letters and digits, as BIDS labels are, got {shown(label)}"
            )
        if (other := seen.get(label.lower())) is not None:
            raise table.error(f"{what}'s name must be there once, got {shown(other)} and {label!r}")
        seen[label.lower()] = label


def device_of(table: Table, folder: Path) -> str:
    """The device of [experiment], a script's file in the folder."""
    text = table.text("device", "hand")
    try:
        device = parse_device(text)
    except ValueError as error:
        raise table.error(f"device {error}") from None
    return f"scripted:{folder / device.file}" if device.kind == "scripted" else str(text)


def network_of(table: Table) -> tuple[float, int | None]:
    """Of [experiment]: age of a lost position [ms], and the port to publish on."""
    lost_after = float(table.number("lost_after_ms", 100.0))
    if lost_after <= 0:
        raise table.error(f"lost_after_ms must be positive, got {shown(lost_after)}")
    publish: int | None = table.value("publish", None)
    if publish is not None and not (type(publish) is int and 0 < publish < 65536):
        raise table.error(f"publish must be a port, 1 to 65535, got {shown(publish)}")
    return lost_after, publish


def without_folder(device: str) -> str:
    """A device's text that is the same on every machine."""
    kind, _, file = device.partition(":")
    return f"scripted:{Path(file).name}" if kind == "scripted" else device


def selection_of(table: Table) -> str | None:
    """The selection of [experiment], which goes into a file of tabs."""
    text: str | None = table.text("selected_by", None)
    if text is not None and any(mark in text for mark in '\t\r\n"'):
        raise table.error(
            f"selected_by must be without tabs, line breaks and quotation marks, got {shown(text)}"
        )
    return text


def selected_from_of(table: Table, subjects: int) -> int | None:
    """Of how many the subjects were selected, of [experiment]."""
    if table.value("selected_from", None) is None:
        return None
    number = table.whole("selected_from")
    if number <= subjects:
        raise table.error(f"selected_from must be more than the {subjects} subjects, got {number}")
    return int(number)


def seconds_of(table: Table, key: str, default: float) -> float:
    """A time from 0 to a day [s]."""
    value = float(table.number(key, default))
    if value < 0:
        raise table.error(f"{key} must be at least 0, got {shown(value)}")
    if value > _LONGEST:
        raise table.error(f"{key} must be at most {_LONGEST:g} [s], got {shown(value)}")
    return value


def burr_and_bone_of(file: Table, folder: Path) -> tuple[Burr, Block]:
    """[burr] and [bone], which must fit one another; a volume's file in the folder."""
    table = file.table("burr")
    with table.errors():
        burr = Burr(table.number("radius_mm"))
    table.done()
    table = file.table("bone")
    size, voxel = table.numbers("size_mm"), table.number("voxel_mm")
    volume = _volume_of(table, folder)
    table.done()
    # Side by side: a cube of a length near the ends of double is 0 or too large.
    if voxel > 0 and (voxels := math.prod(side / voxel for side in size)) > MOST_VOXELS:
        raise table.error(f"the block has {voxels:.3g} voxels, and {MOST_VOXELS:.3g} are the most")
    with table.errors():
        bone = Block(tuple(size), voxel) if volume is None else VolumeBlock(tuple(size), voxel, **volume)
        bone.check_burr(burr)
        if isinstance(bone, VolumeBlock):
            try:
                bone.fresh()  # a volume that cannot be read is no surprise in the first trial
            except OSError as error:
                raise ValueError(str(error)) from None
    return burr, bone


def _volume_of(table: Table, folder: Path) -> dict[str, Any] | None:
    """What makes a `VolumeBlock` of [bone], where it names a volume."""
    keys = ("map", "entry_mm", "axis", "spacing_mm", "series", "crop_mm", "volume_voxel_mm")
    path = table.text("volume", None)
    text, entry, axis = table.text("map", None), table.numbers("entry_mm", None), table.numbers("axis", None)
    spacing, series = table.numbers("spacing_mm", None), table.text("series", None)
    crop, voxel = table.value("crop_mm", None), table.number("volume_voxel_mm", None)
    if path is None:
        for key in keys:
            if key in table:
                raise table.error(f"{key} goes with volume")
        return None
    for key in keys[:3]:
        if key not in table:
            raise table.error(f"{key} is missing: volume needs it")
    if crop is not None and not (isinstance(crop, list) and len(crop) == 2):
        raise table.error(f"crop_mm must be two corners, [[x, y, z], [x, y, z]], got {shown(crop)}")
    with table.errors():
        return {
            "volume": VolumeRecipe(
                str(folder / path),
                OccupancyMap.parse(text),
                spacing,
                series,
                None if crop is None else (crop[0], crop[1]),
                voxel,
            ),
            "entry": tuple(checked_point(entry, "entry_mm").tolist()),
            "axis": tuple(unit_vector(axis).tolist()),
        }


def designs_of(file: Table) -> Mapping[str, Design]:
    """[tasks], with the stimuli of [materials], in the order of the file."""
    stimuli = stimuli_of(file.table("materials", needed=False))
    table = file.table("tasks")
    tables = table.tables()
    if not tables:
        raise table.error("there must be at least one task, [tasks.NAME]")
    _check_labels(table, "a task", list(tables))
    tasks: dict[str, Design] = {}
    for name, one in tables.items():
        tasks[name] = design_of(one, stimuli)
        for other, design in tasks.items():
            if other != name and design.to_dict() == tasks[name].to_dict():
                raise one.error(
                    f"this is task {other} again, trial by trial: give one of them more trials or blocks"
                )
    return MappingProxyType(tasks)


def analysis_of(table: Table) -> AnalysisSettings:
    """[analysis]."""
    rules = table.value("rules", list(RULES))
    if not (
        isinstance(rules, list)
        and rules
        and all(rule in RULES for rule in rules)
        and len({*rules}) == len(rules)
    ):
        raise table.error(
            f"rules must be a list of {', '.join(RULES)}, each once at most, got {shown(rules)}"
        )
    delta, level = table.number("delta", None), table.number("level", 0.95)
    if delta is not None and delta <= 0:
        raise table.error(f"delta must be a d' above 0, got {shown(delta)}")
    if not 0.5 <= level < 1:
        raise table.error(f"level must be from 0.5 to below 1, got {shown(level)}")
    table.done()
    return AnalysisSettings(tuple(rules), delta, level)
