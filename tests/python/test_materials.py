"""Shapes, burrs and materials as values, and the paper's four materials."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import burrlab
from burrlab import materials
from burrlab._core import Burr, Material, Shape

NAMES = ("constant", "linear", "parabolic", "quartic", "power(0.5)", "power(3)", "power(8)")
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
    assert f.order == order
    np.testing.assert_allclose(f(x), definition(x), rtol=1e-13, atol=1e-15)
    assert f(0.5) == f(np.array([0.5]))[0]
    assert f(0.0) == 1.0
    assert f(1.0 + 1e-12) == f(1e6) == 0.0


@pytest.mark.parametrize("name", NAMES)
def test_shape_names_make_the_shape_again(name: str) -> None:
    f = Shape(name)
    assert f.name == str(f) == name
    assert Shape(f.name) == f


def test_shapes_with_two_names() -> None:
    assert Shape("power(1)") == Shape("parabolic")
    assert Shape("power(2.0)").name == "quartic"
    assert Shape("linear") != Shape("parabolic")
    assert Shape("power(0.1)") == Shape(Shape("power(0.1)").name)


@pytest.mark.parametrize(
    "name", ["", "cubic", "Linear", "power", "power()", "power(one)", "power(1", "power(1) "]
)
def test_unknown_shapes(name: str) -> None:
    with pytest.raises(
        ValueError, match=r"shape must be parabolic, linear, quartic, constant or power\(k\), got '"
    ):
        Shape(name)


@pytest.mark.parametrize("k", ["0", "-1", "8.001"])
def test_power_out_of_range(k: str) -> None:
    with pytest.raises(ValueError, match=rf"k of power\(k\) must be in \(0, 8\], got {k}"):
        Shape(f"power({k})")


@pytest.mark.parametrize("x", [-0.1, np.nan])
def test_shape_of_a_bad_radius(x: float) -> None:
    with pytest.raises(ValueError, match="x must be r/R, zero or positive, got"):
        Shape("linear")(np.array([0.5, x]))


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
    assert value == same
    assert hash(value) == hash(same)
    assert value != other
    assert value != "something else"
    assert len({value, same, other}) == 2
    assert pickle.loads(pickle.dumps(value)) == value
    assert eval(repr(value), dict(NAMESPACE)) == value


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


def test_values_cannot_be_changed() -> None:
    for value, name in ((Burr(3.0), "radius"), (materials["bone"], "alpha"), (Shape("linear"), "order")):
        with pytest.raises(AttributeError, match="has no setter"):
            setattr(value, name, 1.0)


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_bad_burr(radius: float) -> None:
    with pytest.raises(ValueError, match=f"radius must be positive and finite, got {radius:g}"):
        Burr(radius)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"c_e": 0.0}, "c_e must be positive and finite, got 0"),
        ({"c_e": np.nan}, "c_e must be positive and finite, got nan"),
        ({"alpha": -0.1}, "alpha must be zero or positive and finite, got -0.1"),
        ({"alpha": np.inf}, "alpha must be zero or positive and finite, got inf"),
    ],
)
def test_bad_material(values: dict[str, float], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Material("a", **({"c_e": 1.0, "alpha": 0.1} | values))


# --- The paper's four -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "c_e", "alpha"),
    [("bone", 2.145, 0.087), ("pettigrew", 1.504, 0.116), ("pvc", 0.462, 0.256), ("expert", 1.5, 0.1)],
)
def test_materials_of_the_paper(name: str, c_e: float, alpha: float) -> None:
    """Agus et al., HAPTICS 2004, section 4.2."""
    material = materials[name]
    assert (material.name, material.c_e, material.alpha) == (name, c_e, alpha)
    assert material.shape == Shape("parabolic")
    assert material.source.startswith("Agus et al., HAPTICS 2004, section 4.2: ")
    assert "f and voxel size are unknown" in material.source
    assert "one drill, burr type and speed" in material.source


def test_there_are_four() -> None:
    assert list(materials) == ["bone", "pettigrew", "pvc", "expert"]
    assert burrlab.materials is materials


def test_mapping_is_read_only() -> None:
    with pytest.raises(TypeError, match="does not support item assignment"):
        materials["bone"] = materials["pvc"]  # type: ignore[index]
    with pytest.raises(TypeError, match="does not support item deletion"):
        del materials["bone"]  # type: ignore[attr-defined]


def test_an_unknown_shape_of_a_material_has_its_own_sentence():
    with pytest.raises(ValueError, match="shape must be parabolic, linear, quartic, constant or power"):
        burrlab.Material("x", c_e=1, alpha=1, shape="cubic")


def test_names_of_powers_are_short_and_read_back():
    assert burrlab.Shape("power(1.1)").name == "power(1.1)"
    assert burrlab.Shape("power(2)").name == "quartic"
    for k in (0.1, 1 / 3, 2.5, 7.9999999999):
        assert burrlab.Shape(burrlab.Shape(f"power({k!r})").name).order == k
    for text in ("power(0x1p0)", "power( 1.5)", "power()", "power(nan)"):
        with pytest.raises(ValueError, match="shape must be"):
            burrlab.Shape(text)
