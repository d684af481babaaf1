"""Depth-time records as CSV text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import IO, TYPE_CHECKING, Any

from burrlab import csv_text

if TYPE_CHECKING:
    from burrlab.depth_trace import DepthTrace

COLUMNS = {"time": "time_s", "immersion": "immersion_mm"}
UNITS = {"time": "s", "immersion": "mm"}


def problem_in_row(row: Mapping[str, float]) -> csv_text.Problem:
    """The first rule that a row of numbers breaks, as (name, sentence); None where it breaks none."""
    for name, value in row.items():
        if not math.isfinite(value):
            return name, f"must be a finite number, in {UNITS[name]}: got {value!r}"
    return None


_LAYOUT = csv_text.Layout(
    columns=COLUMNS, filled={"time": "a time", "immersion": "an immersion"}, problem=problem_in_row
)


def read(
    file: csv_text.Path | IO[str] | IO[bytes], force: float | None, radius: float | None
) -> tuple[str, dict[str, Any]]:
    """The file's name and the arguments of a DepthTrace. See `DepthTrace.from_csv`."""
    name, comments, columns = csv_text.read(file, _LAYOUT)
    start, end = _window(name, comments)
    return name, {
        **columns,
        "force": csv_text.agreed_number(name, comments, "force_N", "force", force),
        "radius": csv_text.agreed_number(name, comments, "radius_mm", "radius", radius),
        "start_mm": start,
        "end_mm": end,
        **csv_text.origin(name, comments),
    }


def write(trace: DepthTrace, file: csv_text.Path | IO[str]) -> None:
    """Write a record as CSV text. See `DepthTrace.to_csv`."""
    comments = csv_text.origin_comments(
        trace.source, trace.provenance, force_N=trace.force, radius_mm=trace.radius
    )
    comments["window_mm"] = f"{trace.start_mm!r} {trace.end_mm!r}"
    csv_text.write(file, comments, table(trace))


def table(trace: DepthTrace) -> dict[str, list[float]]:
    """The record's columns by their names in the CSV file."""
    return {column: getattr(trace, name).tolist() for name, column in COLUMNS.items()}


def _window(file: str, comments: Mapping[str, str]) -> tuple[float | None, float | None]:
    if "window_mm" not in comments:
        return None, None
    try:
        start, end = map(float, comments["window_mm"].split())
    except ValueError:
        raise ValueError(
            f"{file}: window_mm in the comments must be two numbers, start and end: "
            f"got {comments['window_mm']!r}"
        ) from None
    return start, end
