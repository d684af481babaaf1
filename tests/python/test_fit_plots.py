"""Figures of a fit: what they say, on axes with units."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest
from fit_scenes import BONE, DATA, curve_of, fitted

from burrlab._core import Burr
from burrlab.fitting.fit import fit
from burrlab.fitting.profile import ALPHA, C_E

mpl.use("Agg")
LABELS = {"c_e": "$c_e$ [N/mm²]", "alpha": "$\\alpha$ [1/ms]"}


def legend(ax) -> list[str]:
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_region():
    ax = fitted("wide").plot_region(points={"paper": (2.145, 0.087)})
    assert (ax.get_xlabel(), ax.get_ylabel()) == tuple(LABELS.values())
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert legend(ax) == ["99.7 %", "95 %", "68 %", "fit", "paper"]
    shown = legend(fitted("ridge").plot_region())[:3]
    assert shown == ["99.7 %, open above", "95 %, open above", "68 %"]


@pytest.mark.parametrize("names", [("wide",), ("ridge",), ("ridge", "pressed")])
@pytest.mark.parametrize(("name", "direction"), [("c_e", C_E), ("alpha", ALPHA)])
def test_profile(name, direction, names):
    result = fitted(*names)
    ax = result.plot_profile(name)
    assert (ax.get_xlabel(), ax.get_ylabel()) == (LABELS[name], "rise of $-2 \\log L$")
    texts = {text.get_text() for text in ax.texts}
    assert {"68 %", "95 %", "99.7 %"} <= texts
    assert ("open above" in texts) == (names == ("ridge",))
    # an indentation has a scatter of its own, so that the limits of alpha differ from those of c_e
    limits = [result.evidence.calibration.limit(level, direction) for level in (0.68, 0.95, 0.997)]
    drawn = sorted(line.get_ydata()[0] for line in ax.lines if line.get_linestyle() == "--")
    np.testing.assert_allclose(drawn, limits)
    # the curve passes through the fit, reaches the lower end's limit, and is drawn without gaps
    x, rise = (np.asarray(values) for values in ax.lines[0].get_data())
    value, end = getattr(result, name), result.intervals[name]["95"].lower
    assert x[0] < end < value < x[-1]
    assert np.interp(value, x, rise) < 0.1
    assert np.interp(end, x, rise) == pytest.approx(limits[1], rel=0.05)
    if names == ("wide",):  # and without jags
        near, low = rise < limits[2], int(np.argmin(rise))
        assert (np.diff(rise[low:])[near[low + 1 :]] > -1e-3).all()
        assert (np.diff(rise[: low + 1])[near[:low]] < 1e-3).all()


def test_velocities():
    ax = fitted("wide").plot(alpha_lines=0.01)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("force [N]", "penetration velocity [mm/s]")
    shown = legend(ax)
    assert (shown[:2], shown[3]) == (["synthetic data", "95 % band"], "$\\alpha$ ± 0.01 /ms")
    assert len(ax.lines) == 4
    force, velocity = ax.lines[1].get_data()
    np.testing.assert_allclose(velocity, fitted("wide").velocity(force))
    assert force.max() == pytest.approx(1.04 * 2.6)
    assert fitted("wide").plot(ax, log=True) is ax


def test_traces_and_another_radius_in_the_figure():
    small = curve_of([0.1, 0.2, 0.5], burr=Burr(1.5), material=BONE)
    result = fit([DATA["wide"], small, DATA["trace"]])
    assert {"segments of traces", "fit, over each row's window", "fit, R = 1.5 mm"} <= set(
        legend(result.plot(log=True))
    )
    with pytest.raises(ValueError, match="radius must be given: the data are of several radii"):
        result.velocity(1.0)
