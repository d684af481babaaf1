"""Figures of a fit: what they say, on axes with units."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot

from burrlab import materials
from burrlab._core import Burr
from burrlab.fitting.fit import fit
from burrlab.fitting.profile import ALPHA
from burrlab.measured.synthetic import synthetic_curve, synthetic_indentation, synthetic_trace

mpl.use("Agg")

BURR, BONE = Burr(3.0), materials["bone"]
WIDE = synthetic_curve(BURR, BONE, np.geomspace(0.3, 2.6, 6), repeats=3, scatter=0.08, seed=3)
RIDGE = synthetic_curve(BURR, BONE, [0.3, 0.4, 0.5, 0.6], repeats=3, scatter=0.08, seed=3)
C_E_LABEL, ALPHA_LABEL = "$c_e$ [N/mm²]", "$\\alpha$ [1/ms]"


@pytest.fixture(autouse=True)
def _close():
    yield
    pyplot.close("all")


def legend(ax) -> list[str]:
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_region():
    ax = fit(WIDE).plot_region(points={"paper": (2.145, 0.087)})
    assert (ax.get_xlabel(), ax.get_ylabel()) == (C_E_LABEL, ALPHA_LABEL)
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert legend(ax) == ["99.7 %", "95 %", "68 %", "fit", "paper"]
    assert legend(fit(RIDGE).plot_region())[:3] == [
        f"{level} %, open above" for level in ("99.7", "95", "68")
    ]


@pytest.mark.parametrize(("curve", "is_open"), [(WIDE, False), (RIDGE, True)])
@pytest.mark.parametrize(("name", "label"), [("c_e", C_E_LABEL), ("alpha", ALPHA_LABEL)])
def test_profile(name, label, curve, is_open):
    result = fit(curve)
    ax = result.plot_profile(name)
    assert (ax.get_xlabel(), ax.get_ylabel()) == (label, "rise of $-2 \\log L$")
    texts = {text.get_text() for text in ax.texts}
    assert {"68 %", "95 %", "99.7 %"} <= texts
    assert ("open above" in texts) == is_open
    # the curve passes through the fit, reaches the lower end's limit, and is drawn without gaps
    x, rise = (np.asarray(values) for values in ax.lines[0].get_data())
    value = getattr(result, name)
    assert x[0] < result.intervals[name]["95"].lower < value < x[-1]
    assert np.interp(value, x, rise) < 0.1
    end = result.intervals[name]["95"].lower
    direction = np.array([1.0, 0.0]) if name == "c_e" else ALPHA
    assert np.interp(end, x, rise) == pytest.approx(
        result.evidence.calibration.limit(0.95, direction), rel=0.05
    )


def test_limits_of_alpha_are_its_own():
    """Where an indentation has a scatter of its own, the limits of alpha differ from those of c_e."""
    pressed = synthetic_indentation(BURR, BONE, [0.1, 0.2, 0.3], scatter=0.03, seed=2)
    result = fit([RIDGE, pressed])
    ax = result.plot_profile("alpha")
    drawn = sorted(line.get_ydata()[0] for line in ax.lines if line.get_linestyle() == "--")
    levels = (0.68, 0.95, 0.997)
    np.testing.assert_allclose(drawn, [result.evidence.calibration.limit(level, ALPHA) for level in levels])
    assert drawn[1] != pytest.approx(result.evidence.profile.limits["95"], rel=0.02)


def test_traces_and_another_radius_in_the_figure():
    small = synthetic_curve(Burr(1.5), BONE, [0.1, 0.2, 0.5], repeats=1, scatter=0.05, seed=1)
    result = fit([WIDE, small, synthetic_trace(BURR, BONE, 1.0, seed=1)])
    ax = result.plot(log=True)
    assert "segments of traces" in legend(ax)
    assert "fit, over each row's window" in legend(ax)
    with pytest.raises(ValueError, match="radius must be given: the data are of several radii"):
        result.velocity(1.0)


def test_the_profile_over_alpha_is_smooth():
    profile = fit(WIDE).evidence.profile
    low = int(np.argmin(profile.alpha_rise))
    assert (np.diff(profile.alpha_rise[low:]) > -1e-3).all()
    assert (np.diff(profile.alpha_rise[: low + 1]) < 1e-3).all()
