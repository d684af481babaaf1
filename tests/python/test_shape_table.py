"""Shapes from a table: the named f again from a table of it, what files keep, and what is refused."""

import io
import pickle

import numpy as np
import pytest
from command_line import refusal, said
from fit_scenes import BURR, curve_of
from session_scenes import ended
from tick_scenes import TABLES

from burrlab import (
    Clock,
    DescentSettings,
    Fit,
    Law,
    MasterCurve,
    Material,
    ScriptedDevice,
    Session,
    Shape,
    Tissue,
    Tissues,
    VoxelBone,
    compare_laws,
    descend,
    fit,
    load_trace,
    replay,
)
from burrlab._core import shape_kappa
from burrlab.bone.snapshot import tissues_from_json, tissues_to_json
from burrlab.common.study import key_of
from burrlab.session.trace import tool_of

X = 1 - np.linspace(1, 0, 33) ** 2
PHI = np.geomspace(1e-4, 0.19, 30)
COSINE = Shape.from_table(X, lambda x: np.cos(np.pi / 2 * x))


def table_of(name, x=X, **options):
    return Shape.from_table(x, Shape(name), **options)


def test_linear_between_points_and_a_power_at_the_end():
    f = Shape.from_table([0, 0.5, 0.8, 1], [8, 4, 1, 0])  # divided by f(0)
    assert f.order == 2  # log 4/log 2.5 = 1.51
    at = np.array([0.0, 0.25, 0.5, 0.65, 0.8, 0.9, 1.0, 1.1])
    root = np.interp(at, [0, 0.5, 0.8, 1, 1.0001, 2], [1, 0.5**0.5, 0.125**0.5, 0, 0, 0])
    np.testing.assert_allclose(f(at), root**2, rtol=1e-14, atol=1e-16)
    assert shape_kappa(f) == pytest.approx(0.125 / 0.2**2)
    edge = Shape.from_table([0, 0.5, 1], [2, 1, 0.5])
    assert (edge.order, shape_kappa(edge), edge(0.75), edge(1.0)) == (0, 0.25, 0.375, 0.25)
    assert COSINE.order == 1, "cos(pi/2) is 6e-17: that counts as zero"
    assert Shape.from_table(X, COSINE(X), order=1.5).order == 1.5


@pytest.mark.parametrize("f", [COSINE, *map(Shape, TABLES)], ids=lambda f: f.label)
def test_the_name_is_the_table(f):
    assert Shape(f.name) == f == pickle.loads(pickle.dumps(f))
    assert Shape(f.name).name == f.name
    assert f.name not in repr(f)
    assert f.label in repr(Material("own", c_e=1, alpha=1, shape=f))


def test_two_tables_are_two_shapes():
    values = COSINE(X)
    values[7] = np.nextafter(values[7], 0)
    near = Shape.from_table(X, values)
    assert near != COSINE
    assert (near.label != COSINE.label, hash(near) != hash(COSINE)) == (True, True)
    assert key_of(round, near) != key_of(round, COSINE)
    low, high = MasterCurve(TABLES[0]).velocity_ratio(0.1), MasterCurve(TABLES[3]).velocity_ratio(0.1)
    assert low < 0.5 * high


@pytest.mark.parametrize(("name", "error"), [("parabolic", 5e-4), ("quartic", 1e-3), ("power(1.5)", 1e-3)])
def test_master_curve_of_a_table_is_that_of_its_shape(name, error):
    """The error of a table of n points falls as 1/n^2."""
    exact = MasterCurve(name).velocity_ratio(PHI)
    for points, part in ((33, 1.0), (65, 0.25)):
        ratio = MasterCurve(table_of(name, 1 - np.linspace(1, 0, points) ** 2)).velocity_ratio(PHI) / exact
        assert np.abs(ratio - 1).max() < part * error


@pytest.mark.parametrize("x", [X, np.linspace(0, 1, 21)], ids=["dense at the surface", "even"])
def test_the_order_is_that_of_the_tables_end(x):
    for name in ("linear", "parabolic", "quartic", "power(0.5)", "power(1.25)", "power(1.5)", "power(3)"):
        assert table_of(name, x).order == Shape(name).order, name
    noisy = np.random.default_rng(1).normal(1, 0.01, len(x)) * COSINE(x)
    assert 0.5 <= Shape.from_table(x, np.minimum(noisy, noisy[0])).order <= 1.5


@pytest.mark.parametrize("scheme", ["layer", "cell"])
@pytest.mark.parametrize("name", ["parabolic", "quartic"])
def test_descent_with_a_table_is_that_with_its_shape(name, scheme):
    made = [
        descend(
            BURR, Material("m", c_e=2.145, alpha=0.087, shape=f), 2.0, voxel=0.3, seed=1, ideal=True,
            settings=DescentSettings(scheme=scheme),
        ).penetration_velocity
        for f in (name, table_of(name))
    ]  # fmt: skip
    assert made[1] == pytest.approx(made[0], rel=5e-3)


def test_fit_json_and_bootstrap():
    own = Material("own", c_e=2.145, alpha=0.087, shape=COSINE)
    curve = curve_of(material=own, scatter=0.03, seed=2)
    found = fit(curve, BURR, law=COSINE)
    assert found.status == "ok"
    assert found.intervals["c_e"]["95"].lower < own.c_e < found.intervals["c_e"]["95"].upper
    assert found.provenance["shape"] == curve.provenance["shape"] == COSINE.name
    file = io.StringIO()
    found.to_json(file)
    again = Fit.from_json(io.StringIO(file.getvalue()))
    assert (again.shape, again.c_e, again.alpha) == (COSINE, found.c_e, found.alpha)
    assert again.velocity(1.0) == found.velocity(1.0)
    assert COSINE.label in found.report()
    assert COSINE.name not in found.report() + repr(found)
    np.testing.assert_array_equal(*(each.bootstrap(4, seed=1).c_e for each in (found, again)))
    compared = compare_laws(curve, BURR, laws=[Law(COSINE), "quartic"])
    assert compared[COSINE.label].fit.alpha == found.alpha
    assert COSINE.name not in repr(compared) + "".join(compared.sentences)


def test_fit_with_a_table_of_parabolic():
    curve = curve_of()
    exact, own = (fit(curve, BURR, law=f) for f in ("parabolic", table_of("parabolic")))
    assert (own.c_e, own.alpha) == pytest.approx((exact.c_e, exact.alpha), rel=1e-3)


def test_trace_and_tissues_keep_it(tmp_path, cpu_path):
    own = Material("own", c_e=2.145, alpha=0.087, shape=COSINE, force_exponent=2.0)
    bone = VoxelBone.block((10, 8, 4), 0.2, origin=(-5, -4, -4))
    device = ScriptedDevice([0.0, 0.5], [(-1, 0, 2.8), (1, 0, 2.7)])
    file = tmp_path / "own.h5"
    session = Session(bone, (BURR, own), device, seed=1, clock=Clock(wall_clock=False), record=file)
    cut = ended(session).snapshot()[0]
    trace = load_trace(file)
    assert tool_of(session.provenance["tools"][0], "own", "") == (BURR, own)
    assert trace.tools[0][1] == own
    again = replay(trace)
    assert (again.equal, again.bone.digest()) == (True, cut.digest())
    assert cut.removed > 0.1
    tissues = Tissues([Tissue("bone", label=1, c_e=2, alpha=0.1)], own)
    assert tissues_from_json(tissues_to_json(tissues)).material == own


def test_command_line_and_store(tmp_path, capsys):
    curve, file, store = (tmp_path / name for name in ("curve.csv", "fit.json", "store.jsonl"))
    sweep = ("sweep", "--forces", "2:3:3", "--voxel", 0.4, "--seed", 1, "--store", store, "--out", curve)
    for f, descents in ((COSINE, 3), (COSINE, 3), (table_of("linear"), 6)):  # the second finds them all
        said(capsys, *sweep, "--shape", f.name)
        assert store.read_text().count('"result"') == descents
    own = tmp_path / "own.csv"
    np.savetxt(own, np.transpose([X, COSINE(X)]), "%.17g", ",", header="x,f", comments="")
    assert "nlopt" in said(capsys, "fit", curve, "--shape", own, "--json", file, "--verbose")
    assert Fit.from_json(file).shape == COSINE


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (
            "x,g 0,1",
            "own.csv: 2 faults: line 1: unknown column 'g'; known are x, f; line 1: column f is missing",
        ),
        (
            "x,f 0,1 0.5,a 0.7,-1 ,0",
            "own.csv: 3 faults: line 3, column f: 'a' is not a number; line 4, column f",
        ),
        ("x,f 0,1 0.5,0.5 0.4,0.4 1,0", "own.csv, line 4, column x: must be above the 0.5 of the row before"),
        ("x,f 0,1 0.5,1.2 1,0", "own.csv, line 3, column f: must be at most f(0) = 1: got 1.2"),
        ("x,f 0,1 0.5,0.2 0.9,0", "own.csv: the last x of a table must be 1, got 0.9"),
    ],
)
def test_files_that_are_no_shape(rows, told, here, capsys):
    (here / "own.csv").write_text(rows.replace(" ", "\n"))
    assert f"--shape: {told}" in refusal(capsys, "fit", "curve.csv", "--shape", "own.csv")
    assert "none.csv: No such file" in refusal(capsys, "fit", "curve.csv", "--shape", "none.csv")


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        *((lambda x=x, f=f, options=options: Shape.from_table(x, f, **options), words) for x, f, options, words in [
            ([0, 1], [1, 0], {}, "points of a table must be 3 to 256, got 2"),
            ([0, 0.5, 1], [1, 0], {}, "f must be as long as x, 3, got 2"),
            ([0, 0.5, 1], [1, np.nan, 0], {}, "every f of a table must be finite, got nan"),
            ([0, 0.5, 0.5, 1], [1, 0.6, 0.5, 0], {}, "x of a table must be rising by 1e-6 or more, got 0.5"),
            ([0.1, 0.5, 1], [1, 0.5, 0], {}, "the first x of a table must be 0, got 0.1"),
            ([0, 0.5, 0.9], [1, 0.5, 0], {}, "the last x of a table must be 1, got 0.9"),
            ([0, 0.5, 1], [1, 1.2, 0], {}, r"f of a table must be at most f\(0\) = 1, its maximum, got 1.2"),
            ([0, 0.5, 1], [1, 0.5, -0.1], {}, "f of a table must be zero or positive, got -0.1"),
            ([0, 0.5, 1], [1, 0, 0], {}, r"f of a table must be above 1e-9 f\(0\) below x = 1, got 0"),
            ([0, 0.5, 1], [1, 0.5, 0], {"order": 9}, r"order of a table with f\(1\) = 0 must be in \(0, 8\], got 9"),
            ([0, 0.5, 1], [1, 0.5, 0.1], {"order": 1}, r"order of a table with f\(1\) above 0 must be 0, got 1"),
            ([0, 0.5, 1], "abc", {}, "f of a table must be a list of numbers, got 'abc'"),
        ]),
        *((lambda name=name: Shape(name), r"a table must read table\(k;x:f,x:f,...\), got 'table")
          for name in ("table()", "table(1;0:1,1)", "table(1;0:1,0.5:0.5,1:0", "table(0:1,0.5:0.5,1:0)")),
    ],
)  # fmt: skip
def test_refusals(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()
