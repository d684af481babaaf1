"""All plots: they take ax, label and color, share their Axes, and their legends cover no data."""

import re
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.text import Text
from session_scenes import refused

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
import burrlab
from burrlab.anatomy import compare_with_target
from burrlab.common.figures import SERIES, paper
from burrlab.psychophysics.psychometric import psychometric_function
from burrlab.view import plot_depth_map, plot_slices
from golden.cases import BONE, BURR, objects

PLOTS = [
    "curve.plot", "fit.plot", "fit.plot_profile", "fit.plot_region", "fit.plot_residuals", "indentation.plot",
    "depth trace.plot", "mean field.plot", "laws.plot", "laws.plot_exponent", "metrics.plot", "anatomy.plot",
    "descent.plot", "design.plot", "scatter.plot", "target.plot", "session.plot", "psychometric.plot",
    "scored.plot_scores", "scored.plot_intervals", "scored.plot_d_prime", "thresholds.plot_thresholds",
    "slices.plot", "map.plot", "curves.plot", "compared.plot", "compared four.plot", "near many.plot",
]  # fmt: skip


@cache
def four():
    """Fits, and one curve, of four materials."""
    made = {}
    for one in (
        *(burrlab.materials[name] for name in ("bone", "pettigrew", "pvc")),
        burrlab.Material("soft", c_e=1.0, alpha=0.2),
    ):
        forces = np.linspace(0.15, 0.7, 8) * 0.1925 * one.c_e * BURR.radius**2
        made[one.name] = burrlab.synthetic_curve(BURR, one, forces, repeats=2, scatter=0.08, seed=len(made))
    return {name: one if name == "pvc" else burrlab.fit(one) for name, one in made.items()}


@cache
def results():
    from test_analysis import FOUR, only, thresholds
    from test_target import BONE as LABELLED
    from test_target import REGION

    block = burrlab.VoxelBone.block((4, 4, 2), 0.2)
    density = block.density.copy()
    density[6:, 4:14, 6:17] = 0
    block.restore(density)
    rows = [burrlab.Tissue(f"tissue {i} of 15", label=i, c_e=2.0, alpha=0.1) for i in range(15)]
    block.set_tissues(
        burrlab.Tissues(rows, BONE), np.arange(density.size, dtype=np.uint8).reshape(density.shape) % 15
    )
    with burrlab.Session(
        block, (BURR, BONE), burrlab.HandDevice(), seed=1, duration=0.3, clock=burrlab.Clock(wall_clock=False)
    ) as session:
        session.wait()
    drawn = {
        "slices": partial(plot_slices, block, (2, 2, 1), radii=[3.0], centers=[(2, 2, 3)], note="at 0.5 s"),
        "map": partial(plot_depth_map, block), "curves": partial(burrlab.plot_curves, four()),
    }  # fmt: skip
    one = objects()["anatomy"]
    doses = np.repeat(one.watched.doses, 15, axis=1)
    doses["closest_mm"] += np.arange(15)[::-1]
    rows = [{"name": f"nerve {i}", "injury_mm3": 0.0} for i in range(15)]
    names = tuple(row["name"] for row in rows)
    many = replace(
        one, structures=names, tissues=names, settings={"structures": rows},
        watched=replace(one.watched, doses=doses, removed=np.zeros(15, int)),
    )  # fmt: skip
    return objects() | {name: type("Picture", (), {"plot": staticmethod(draw)}) for name, draw in drawn.items()} | {
        "design": burrlab.design(objects()["fit"], [0.6, 1.2, 2.0], [2.0, 3.0], 2, static=[0.2]),
        "scatter": burrlab.predicted_scatter(BURR, BONE, [0.8, 1.6], burrlab.BoneField(), repeats=3, voxel=0.4, seed=1),
        "target": compare_with_target(LABELLED, REGION), "session": session.report(), "scored": only(FOUR),
        "near many": many, "compared": burrlab.compare(*list(four().values())[:2], margin=0.2),
        "compared four": burrlab.compare(
            *(one if isinstance(one, burrlab.Fit) else burrlab.fit(one) for one in four().values()),
            margin=0.2, names=[f"folder/a curve of {name}.csv" for name in four()],
        ),
        "psychometric": psychometric_function([1.1, 1.3, 1.6], [11, 15, 19], [20, 20, 20]),
        "thresholds": thresholds((1.2, (1.1, 1.3)), (1.3, None), (1.25, None), design={"parameter": "c_e"}),
    }  # fmt: skip


def drawn(name, **options):
    one, _, way = name.partition(".")
    made = getattr(results()[one], way)(**options)
    return made if isinstance(made, list) else [made]


def words(axes):
    """The words of the legends, in the order of reading."""
    legends = [one.get_legend() for one in axes if one.get_legend()] + axes[0].figure.legends
    texts = [text for legend in legends for text in legend.get_texts()]
    places = {text: text.get_window_extent() for text in texts}
    return [
        text.get_text()
        for text in sorted(texts, key=lambda text: (-round(places[text].y0, -1), places[text].x0))
    ]


@paper()
@pytest.mark.parametrize("name", PLOTS)
def test_a_plot_is_readable_and_shares_its_axes(name, tmp_path):
    """Legends cover no data, all words are on the paper, and a second plot on the Axes hides nothing."""
    axes = drawn(name)
    figure = axes[0].get_figure(root=True)
    figure.draw_without_rendering()
    for text in figure.findobj(Text):
        if text.get_text() and text.get_visible() and text.get_window_extent().width:
            assert text.get_fontsize() >= 8 or "$" in text.get_text()
    assert all(one.get_window_extent().width <= figure.bbox.width for one in figure.legends)
    for one in axes:
        for axis in (one.xaxis, one.yaxis):
            (low, high), ticks = sorted(axis.get_view_interval()), axis.get_ticklocs()
            assert axis.get_scale() != "log" or sum((low <= ticks) & (ticks <= high)) > 1
        page, box = figure.bbox.padded(4), one.get_tightbbox()
        assert (page.union([page, box]).size <= page.size + 1e-6).all()
        if (legend := one.get_legend()) is None:
            continue
        box = legend.get_window_extent()
        assert not any(text.get_window_extent().overlaps(box) for text in one.texts)
        for part in (*one.lines, *one.collections, *one.patches):
            offsets = getattr(part, "get_offsets", lambda: [[0, 0]])()
            paths = part.get_paths() if hasattr(part, "get_paths") else [part.get_path()]
            seen = box.overlaps(one.bbox) or not part.get_clip_on()
            if seen and len(offsets) == 1 and part.get_zorder() >= 1:
                shapes = [part.get_transform().transform_path(path) for path in paths if len(path.vertices)]
                meet = box.count_contains if part in one.lines and part.get_linestyle() == "None" else None
                assert not any(
                    meet(shape.vertices) if meet else shape.intersects_bbox(box, False) for shape in shapes
                )

    before = words(axes)
    for one in axes:
        one.set(xlim=np.array(one.get_xlim()) * [1, 1.5], ylim=np.array(one.get_ylim()) * [1, 1.5])
    limits = [(one.get_xlim(), one.get_ylim()) for one in axes]
    style = {"color": "#123456"} | ({} if name == "curves.plot" else {"label": "second"})
    assert drawn(name, ax=axes if len(axes) > 1 else axes[0], **style) == axes
    for one, old in zip(axes, limits, strict=True):
        for now, then in zip((one.get_xlim(), one.get_ylim()), old, strict=True):
            assert [min(*now, *then), max(*now, *then)] == sorted(now)
    assert set(before) <= set(words(axes))
    bars = [bar.get_ylabel() for one in axes for bar in one.child_axes]
    assert "label" not in style or any("second" in said for said in words(axes) + bars)
    figure.savefig(tmp_path / "seen.svg")
    assert "#123456" in (tmp_path / "seen.svg").read_text()


def test_of_many_structures_the_nearest_are_shown():
    top, bottom = drawn("near many.plot")
    assert (
        words([top])
        == [f"nerve {i}" for i in range(10, 15)]
        == [text.get_text() for text in bottom.get_yticklabels()]
    )
    assert top.get_legend().get_window_extent().y1 < top.bbox.y0
    said, report = "10 structures farther away are left out", results()["near many"]
    assert (top.get_title(), said in str(report), "0    nerve 9 " in str(report)) == (said, True, False)
    assert "0    nerve 0 " in report.table()


def test_too_few_axes_are_refused():
    refused((lambda: objects()["descent"].plot([Figure().subplots()]), "ax must hold 3 Axes, got 1"))


def test_several_curves_differ_in_grey_and_show_their_kinks(tmp_path):
    grey = [np.array(to_rgba(one["color"])[:3]) @ (0.2126, 0.7152, 0.0722) for one in SERIES[:4]]
    assert np.diff(np.sort(grey)).min() > 0.1
    assert all(
        len({str(one[key]) for one in SERIES}) == len(SERIES) for key in ("color", "marker", "linestyle")
    )
    with paper("single"):
        axes = burrlab.plot_curves(four())
        axes.figure.savefig(tmp_path / "four.pdf")
    assert [*four(), "kink: $c_e$ shows above", "95 % band"] == words([axes])
    kinks = [
        line.get_xdata()[0]
        for line in axes.lines
        if line.get_marker() == (2, 2, 45) and len(line.get_xdata())
    ]
    assert kinks == pytest.approx([
        fit.c_e * BURR.radius**2 * (1 / 6) ** 1.5 for fit in four().values() if isinstance(fit, burrlab.Fit)
    ])  # fmt: skip
    written = (tmp_path / "four.pdf").read_bytes()
    assert (b"/FontFile2" in written, b"/Type3" in written) == (True, False)
    assert axes.figure.get_size_inches().tolist() == pytest.approx([3.5, 2.625])
    assert len(words([burrlab.plot_curves([objects()["curve"], four()["bone"]])])) == 4
    refused(
        (lambda: burrlab.plot_curves([]), "items must hold a curve or a fit, got none"),
        (lambda: burrlab.plot_curves([7]), "items must be VelocityCurve or Fit, got int for '1'", TypeError),
    )


@pytest.mark.parametrize("way", ["plot", "plot_region"])
def test_a_second_fit_is_within_the_limits_and_has_its_own_colour(way):
    fits, axes = [four()[name] for name in ("soft", "bone", "pettigrew")], None
    for name, one in enumerate(fits):
        axes = getattr(one, way)(ax=axes, label=f"fit {name}")
    named = [line for line in axes.lines if line.get_label().startswith("fit ")]
    assert [line.get_color() for line in named] == [one["color"] for one in SERIES[:3]]
    assert words([axes])[:3] == ["fit 0", "fit 1", "fit 2"]
    seen = [one.c_e if way == "plot_region" else one.curve.force.max() for one in fits]
    assert axes.get_xlim()[0] < min(seen) < max(seen) < axes.get_xlim()[1]
    assert way == "plot_region" or axes.get_ylim()[1] > max(one.curve.velocity.max() for one in fits)


def test_residuals_name_the_row_that_stands_out():
    curve = objects()["curve"]
    fit = burrlab.fit(
        burrlab.VelocityCurve(curve.force, curve.velocity * np.where(np.arange(len(curve)) == 4, 2.5, 1.0)),
        BURR,
    )
    axes, rows = fit.plot_residuals(), fit.influence()
    assert (
        [text.get_text() for text in axes.texts]
        == [f"row {row.row}" for row in rows if row.named]
        == ["row 5"]
    )
    limit = float(re.search(r"±([\d.]+)", " ".join(words([axes]))).group(1))
    assert max(abs(row.studentised) for row in rows if not row.named) < limit < abs(rows[4].studentised)
    few = burrlab.fit(burrlab.VelocityCurve(curve.force[::5], curve.velocity[::5]), BURR)
    assert "no limit below 8 rows" in few.plot_residuals().get_ylabel()
