"""Shapes, burrs and materials as values; the paper's four materials."""

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from burrlab import Burr, Material, Shape, _core, elastic_force, materials, penetration

NAMESPACE = {"Burr": Burr, "Material": Material, "Shape": Shape}


# --- Shapes -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "order", "definition"),
    [
        ("constant", 0.0, lambda x: np.ones_like(x)),
        ("linear", 1.0, lambda x: 1 - x),
        ("parabolic", 1.0, lambda x: 1 - x**2),
        ("quartic", 2.0, lambda x: (1 - x**2) ** 2),
        ("power(1.5)", 1.5, lambda x: (1 - x**2) ** 1.5),
        ("power(8)", 8.0, lambda x: (1 - x**2) ** 8),
    ],
)
def test_shape_values(name: str, order: float, definition: Any) -> None:
    f, x = Shape(name), np.linspace(0, 1, 101)
    assert (f.order, f.name, str(f), Shape(f.name)) == (order, name, name, f)
    np.testing.assert_allclose(f(x), definition(x), rtol=1e-13, atol=1e-15)
    assert (f(0.5), f(0.0)) == (f(np.array([0.5]))[0], 1.0)
    assert f(1.0 + 1e-12) == f(1e6) == 0.0


def test_shapes_with_two_names() -> None:
    assert Shape("power(1)") == Shape("parabolic") != Shape("linear")
    assert Shape("power(2)").name == Shape("power(2.0)").name == "quartic"
    for k in (0.1, 1 / 3, 1.1, 2.5, 7.9999999999):
        assert Shape(Shape(f"power({k!r})").name).order == k
    assert Shape("power(1.1)").name == "power(1.1)"


# --- Values -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "same", "other"),
    [
        (Shape("parabolic"), Shape("power(1)"), Shape("linear")),
        (Burr(3.0), Burr(3), Burr(3.5)),
        (Material("a", c_e=2, alpha=0.1), Material("a", c_e=2.0, alpha=0.1), Material("b", c_e=2, alpha=0.1)),
    ],
    ids=["Shape", "Burr", "Material"],
)
def test_equality_hash_pickle_and_repr(value: Any, same: Any, other: Any) -> None:
    assert (value, hash(value)) == (same, hash(same))
    assert value != other
    assert value != "something else"
    assert len({value, same, other}) == 2
    assert (pickle.loads(pickle.dumps(value)), eval(repr(value), dict(NAMESPACE))) == (value, value)


@pytest.mark.parametrize(
    "change", [{"name": "b"}, {"c_e": 2.5}, {"alpha": 0.2}, {"shape": "linear"}, {"source": "here"}], ids=str
)
def test_every_field_of_a_material_counts(change: dict[str, Any]) -> None:
    fields: dict[str, Any] = {"name": "a", "c_e": 2.0, "alpha": 0.1, "shape": "parabolic", "source": ""}
    changed = Material(**(fields | change))
    assert changed != Material(**fields)
    assert eval(repr(changed), dict(NAMESPACE)) == pickle.loads(pickle.dumps(changed)) == changed


def test_material_takes_a_shape_or_its_name() -> None:
    assert Material("a", c_e=1, alpha=1, shape="quartic") == Material(
        "a", c_e=1, alpha=1, shape=Shape("quartic")
    )
    assert Material("a", c_e=1, alpha=1).shape == Shape("parabolic")
    assert Material("inert", c_e=1, alpha=0).alpha == 0.0


def material(**changes: Any) -> Material:
    return Material("a", **{"c_e": 1.0, "alpha": 0.1, **changes})


SHAPE = rf"shape must be {', '.join(_core.shape_names)} or power\(k\), got '"
UNKNOWN = ("", "cubic", "Linear", "power", "power(one)", "power(15", "power(1) ", "power(0x1p0)", "power( 1.5)", "power()", "power(nan)")  # fmt: skip


@pytest.mark.parametrize(
    ("make", "match"),
    [
        *((lambda name=name: Shape(name), SHAPE) for name in UNKNOWN),
        *((lambda k=k: Shape(f"power({k})"), rf"k of power\(k\) must be 1e-6 to 8, got {k}") for k in ("0", "-1", "8.001")),
        (lambda: Shape("linear")(np.array([0.5, -0.1])), "x must be r/R, zero or positive, got"),
        (lambda: Shape("linear")(np.array([0.5, np.nan])), "x must be r/R, zero or positive, got"),
        (lambda: Burr(0.0), "radius must be positive and finite, got 0"),
        (lambda: Material("m", c_e=1e308, alpha=0.1), r"c_e must be at most 1e12 N/mm\^2, got 1e\+308"),
        (lambda: Burr(-1.0), "radius must be positive and finite, got -1"),
        (lambda: Burr(np.nan), "radius must be positive and finite, got nan"),
        (lambda: Burr(np.inf), "radius must be positive and finite, got inf"),
        (lambda: material(c_e=0.0), "c_e must be positive and finite, got 0"),
        (lambda: material(c_e=np.nan), "c_e must be positive and finite, got nan"),
        (lambda: material(alpha=-0.1), "alpha must be zero or positive and finite, got -0.1"),
        (lambda: material(alpha=np.inf), "alpha must be zero or positive and finite, got inf"),
        (lambda: material(shape="cubic"), SHAPE),
        *((lambda k=k: _core.depth_table(k), rf"order must be in \(0, 8\], got {k}") for k in (0, 8.5, np.nan)),
        (lambda: penetration(-1.0, 3.0), "m0 must be zero or positive and finite, got -1"),
        (lambda: penetration(np.nan, 3.0), "m0 must be zero or positive and finite, got nan"),
        (lambda: penetration(1.0, 0.0), "radius must be positive and finite, got 0"),
        (lambda: elastic_force(1.0, (0, 0, 0), radius=3.0, c_e=0.0), "c_e must be positive and finite, got 0"),
        (lambda: elastic_force(1.0, (0, np.nan, 0), radius=3.0, c_e=1.0), "m1 must be finite"),
        (lambda: elastic_force(1.0, (0, 0, 0), radius=3.0, c_e=1.0, force_exponent=0.9), "force_exponent must be 1 to 8, got 0.9"),
        (lambda: material(force_exponent=np.nan), "force_exponent must be 1 to 8, got nan"),
        (lambda: material(rate_exponent=-0.1), "rate_exponent must be 0 to 8, got -0.1"),
        (lambda: materials.__setitem__("bone", None), "no attribute '__setitem__'"),
        (lambda: setattr(Burr(3.0), "radius", 1.0), "has no setter"),
        (lambda: setattr(materials["bone"], "alpha", 1.0), "has no setter"),
        (lambda: setattr(Shape("linear"), "order", 1.0), "has no setter"),
    ],
)  # fmt: skip
def test_refusals(make: Callable[[], object], match: str) -> None:
    with pytest.raises((ValueError, AttributeError), match=match):
        make()


# --- The paper's four -------------------------------------------------------------------------------------


def test_materials_of_the_paper() -> None:
    """Source: Agus et al., HAPTICS 2004, section 4.2."""
    paper = {"bone": (2.145, 0.087), "pettigrew": (1.504, 0.116), "pvc": (0.462, 0.256), "expert": (1.5, 0.1)}
    for one in map(materials.__getitem__, paper):
        assert ((one.c_e, one.alpha), one.shape) == (paper[one.name], Shape("parabolic"))
        assert one.source.startswith("Agus et al., HAPTICS 2004, section 4.2: ")
        for words in ("f and voxel size are unknown", "one drill, burr type and speed"):
            assert words in one.source
