"""What a page says beside its picture: numbers, tissues, curves and marks of one moment."""

from __future__ import annotations

from typing import Any

import numpy as np

from burrlab._core import VoxelBone
from burrlab.view.page_chart import WIDTH, polyline, top
from burrlab.view.page_source import PageSource


def numbers(source: PageSource) -> list[dict[str, str]]:
    """Rows of name, value and unit."""
    rows, force, depth, burrs = [], source.force, source.depth, source.burrs
    for i, radius in enumerate(burrs.radii):
        which = f" {i + 1}" if len(burrs.radii) > 1 else ""
        known = bool(np.isfinite(burrs.centers[i]).all())
        place = ", ".join(f"{value:.2f}" for value in burrs.centers[i]) if known else "not known"
        rows += [
            ("force" + which, f"{np.linalg.norm(force[i]):.2f}", "N"),
            ("penetration" + which, f"{depth[i]:.3f}", "mm"),
            ("burr" + which, f"R = {radius:g} mm, {'turns' if burrs.on[i] else 'stands'}", ""),
            ("centre" + which, place, "mm" if known else ""),
        ]
    rows.append(("bone removed", f"{source.bone.removed:.2f}", "mm³"))
    return [{"name": name, "value": value, "unit": unit} for name, value, unit in rows]


def tissues(bone: VoxelBone) -> list[dict[str, Any]]:
    """Rows of the tissues that are critical or of which something was removed."""
    if bone.tissues is None:
        return []
    removed = [bone.removed_of(i) for i in range(len(bone.tissues))]
    return [
        {"name": tissue.name, "colour": "rgb({}, {}, {})".format(*tissue.colour), "removed": f"{volume:.2f}",
         "hurt": tissue.critical and volume > 0}
        for tissue, volume in zip(bone.tissues, removed, strict=True) if volume > 0 or tissue.critical
    ]  # fmt: skip


def charts(source: PageSource) -> list[dict[str, Any]]:
    """Force and penetration over time, one line a burr."""
    history, span, rows = source.history, source.span, []
    for name, unit, values in (("force", "N", history.force), ("penetration", "mm", history.depth)):
        if values.shape[1]:
            most = top(values)
            lines = [polyline(history.time, column, span, most) for column in values.T]
            rows.append({"name": name, "unit": unit, "most": f"{most:g}", "lines": lines})
    return rows


def values(source: PageSource) -> list[list[str]]:
    """That the charts' curves have now: of each chart, a text a burr."""
    force = np.linalg.norm(source.force, axis=1)
    return [[f"{value:.{places}f}" for value in now] for now, places in ((force, 2), (source.depth, 3))]


def events(source: PageSource) -> list[dict[str, Any]]:
    """Rows of what happened, and where its mark is in the charts."""
    first, last = source.span
    return [
        {"time_s": event.time, "clock": f"{event.time:.2f} s", "text": event.text, "colour": event.colour,
         "x": round(WIDTH * (event.time - first) / max(last - first, 1e-9), 1)}
        for event in source.events
    ]  # fmt: skip
