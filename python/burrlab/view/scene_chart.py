"""Force and depth over time, in the lower left of the view."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

_TEXT = (0.92, 0.93, 0.95)
_SPAN = 10.0  # of the time axis [s]


class SceneChart:
    """Two small charts over each other; hidden until there are values.

    Parameters
    ----------
    plotter : pyvista.Plotter
    module : module
        pyvista.
    """

    def __init__(self, plotter: Any, module: Any) -> None:
        self.charts, self.lines = [], []
        for row, (label, colour) in enumerate((("force [N]", "#4EA5E0"), ("depth [mm]", "#3CC49A"))):
            chart = module.Chart2D(
                size=(0.30, 0.155),
                loc=(0.008, 0.17 - 0.16 * row),
                x_label="time [s]" if row else "",
                y_label=label,
            )
            chart.background_color = (0.04, 0.05, 0.07, 0.72)
            chart.border_color = (1.0, 1.0, 1.0, 0.0)
            for axis in (chart.x_axis, chart.y_axis):
                axis.label_size = axis.tick_label_size = 11
                axis.grid = False
                axis.pen.color = axis.tick_label_color = _TEXT
                axis.GetTitleProperties().SetColor(*_TEXT)
                axis.GetLabelProperties().SetColor(*_TEXT)
                axis.GetTitleProperties().SetBold(False)
            self.lines.append(chart.line([0.0, 1.0], [0.0, 0.0], color=colour, width=1.6))
            chart.visible = False
            plotter.add_chart(chart)
            self.charts.append(chart)

    def replace(self, time: ArrayLike, force: ArrayLike, depth: ArrayLike) -> None:
        """The last ten seconds of these values; nothing where there are fewer than two."""
        t = np.asarray(time, float)
        kept = t >= (t[-1] - _SPAN if len(t) else 0.0)
        shown = int(np.count_nonzero(kept)) > 1
        for chart, line, values, least in zip(
            self.charts, self.lines, (force, depth), (0.5, 0.1), strict=True
        ):
            chart.visible = shown
            if not shown:
                continue
            y = np.asarray(values, float)[kept]
            line.update(t[kept], y)
            chart.x_range = (float(t[kept][0]), float(max(t[-1], t[kept][0] + 1e-3)))
            most = max(least, float(np.nanmax(y, initial=0.0)))
            chart.y_range = (0.0, 1.15 * most)
            mark = round_value(most)  # VTK would leave only the zero in a low chart
            chart.y_axis.tick_locations = [0.0, mark]
            chart.y_axis.tick_labels = ["0", f"{mark:g}"]


def round_value(most: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(power * max(step for step in (1, 2, 5) if step * power <= most * (1 + 1e-12)))
