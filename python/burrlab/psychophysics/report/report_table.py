"""Tables of a report: aligned text, HTML, and numbers as they are printed."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from html import escape
from typing import TypeAlias

#: What a column belongs to, its name, its cells.
Column: TypeAlias = tuple[str, str, list[str]]


def tables_lines(columns: Sequence[Column], width: int | None = None) -> list[str]:
    """One table, or as many as a screen of this width needs: parted between groups of columns, each with the first column."""
    if width is None:
        return table_lines(columns)
    first = columns[0]
    parts: list[list[Column]] = [[first]]
    for start, end in _groups(columns[1:]):
        group = list(columns[1:][start : end + 1])
        if len(parts[-1]) > 1 and max(map(len, table_lines([*parts[-1], *group]))) > width:
            parts.append([first])
        parts[-1] += group
    lines: list[str] = []
    for part in parts:
        lines += ["", *table_lines(part)] if lines else table_lines(part)
    return lines


def wrapped_lines(lines: Sequence[str], width: int | None) -> list[str]:
    """Sentences parted between words, what follows further in."""
    if width is None:
        return list(lines)
    found: list[str] = []
    for line in lines:
        inner = " " * (len(line) - len(line.lstrip()) + 4)
        found += textwrap.wrap(
            line, max(width, 40), subsequent_indent=inner, break_long_words=False, break_on_hyphens=False
        ) or [""]
    return found


def table_lines(columns: Sequence[Column]) -> list[str]:
    """Columns aligned under their heads; a head over those that belong together."""
    widths = [max(len(head), *map(len, cells), 1) for _, head, cells in columns]
    above = ""
    for first, last in _groups(columns):
        group = columns[first][0]
        room = sum(widths[first : last + 1]) + 2 * (last - first)
        if len(group) > room:
            widths[first] += len(group) - room
            room = len(group)
        above += group.center(room, "-" if group else " ") + "  "
    rows = [[head for _, head, _ in columns], *map(list, zip(*(cells for *_, cells in columns), strict=True))]
    lines = [
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return [above.rstrip(), *lines] if above.strip() else lines


def _groups(columns: Sequence[Column]) -> list[tuple[int, int]]:
    """First and last column of those that belong together."""
    found: list[tuple[int, int]] = []
    for place, (group, *_) in enumerate(columns):
        if found and group and columns[found[-1][0]][0] == group:
            found[-1] = found[-1][0], place
        else:
            found.append((place, place))
    return found


def table_html(columns: Sequence[Column]) -> str:
    """The same for notebooks."""
    heads = "".join(f"<th>{escape(f'{group}: {head}' if group else head)}</th>" for group, head, _ in columns)
    rows = zip(*(cells for *_, cells in columns), strict=True)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>"


def number(value: float) -> str:
    """Two decimals, no negative zero; inf as a word, NaN as nothing."""
    if math.isnan(value):
        return ""
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return f"{round(value, 2) + 0.0:.2f}"


def interval_text(ends: tuple[float, float]) -> str:
    """Closed, or open above."""
    low, high = ends
    return f"[{low:.2f}, inf)" if math.isinf(high) else f"[{low:.2f}, {high:.2f}]"


def p_text(p: float) -> str:
    """Two digits."""
    return f"{p:.2g}" if p >= 1e-4 else f"{p:.0e}"


def tsv_text(value: float | int | str | None) -> str:
    """A field: n/a for nothing, numbers to the last bit."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "n/a"
    return repr(value) if isinstance(value, float) else str(value)
