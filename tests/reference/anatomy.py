"""Distances to segmented structures, and their events and doses, from the definitions."""

import numpy as np


def distance(points, labels, number, spacing, origin):
    """Distances (n,) [mm] of points (n, 3) [mm] from a label in labels (z, y, x)."""
    centers = np.argwhere(labels == number)[:, ::-1] * np.asarray(spacing) + np.asarray(origin)
    half = np.asarray(spacing) / 2
    gaps = (np.maximum(np.abs(centers - point) - half, 0.0) for point in np.asarray(points, float))
    return np.sqrt([(gap**2).sum(axis=1).min() for gap in gaps])


EDGES = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
NEAR = (1.0, 2.0)


def events(rows, distances, lost, *, approach, touch, injury, hysteresis):
    """Events of one structure: [(row, kind, burr)].

    rows: burrs in the order of execution; distances of the burr's surface [mm] and volume lost by the
    structure [mm^3] in each.
    """
    told, near, touched, injured, total = [], set(), set(), set(), 0.0
    for i, (burr, d, v) in enumerate(zip(rows, distances, lost, strict=True)):
        total += v
        if burr not in near and d <= approach:
            near.add(burr)
            told.append((i, "approach", burr))
        if burr not in touched and d <= touch:
            touched.add(burr)
            told.append((i, "touch", burr))
        if v > 0 and burr not in injured and total > injury:
            injured.add(burr)
            told.append((i, "injury", burr))
        if d > touch + hysteresis:
            touched.discard(burr)
            injured.discard(burr)
        if burr in near and d > approach + hysteresis:
            near.discard(burr)
            told.append((i, "away", burr))
    return told


def dose(distances, k, on, force, *, touch):
    """The dose of one burr beside one structure, times in periods: a dict with the names of `Dose`."""
    out = {"closest": distances.min(), "touching": k[distances <= touch].sum()}
    out["time_within"] = [k[distances <= edge].sum() for edge in EDGES]
    out["turning_within"] = [k[(distances <= edge) & on].sum() for edge in EDGES]
    near = [distances <= edge for edge in NEAR]
    out["mean_force"] = [np.average(force[at], weights=k[at]) if at.any() else np.nan for at in near]
    out["peak_force"] = [force[at].max(initial=0.0) for at in near]
    return out
