"""The materials of the paper."""

from collections.abc import Iterator, Mapping
from typing import Any

from burrlab._core import Material, paper_materials
from burrlab.common.check import nearest
from burrlab.common.figures import SERIES
from burrlab.theory.tool import PAPER_LAW, law_of


class Materials(Mapping[str, Material]):
    """Materials by name, read-only; printed as a table."""

    def __init__(self, *materials: Material) -> None:
        self._named = {material.name: material for material in materials}

    def __getitem__(self, name: str) -> Material:
        if name not in self._named:
            raise KeyError(
                f"material must be one of {', '.join(self._named)}, got {name!r}{nearest(name, self)}"
            )
        return self._named[name]

    def __getattr__(self, name: str) -> Any:
        hint = f": materials[{name!r}]" if name in vars(self).get("_named", ()) else ""
        raise AttributeError(f"materials has no attribute {name!r}{hint}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._named)

    def __len__(self) -> int:
        return len(self._named)

    def __repr__(self) -> str:
        rows = (
            f"{m.name:<10} {m.c_e:>12} {m.alpha:>12}  {m.shape.name:<10} {m.source}" for m in self.values()
        )
        return "\n".join(
            [f"{'name':<10} {'c_e [N/mm^2]':>12} {'alpha [1/ms]':>12}  shape      source", *rows]
        )


def constants_of(material: Material) -> dict[str, Any]:
    """The constants and the law of a material, as files hold them."""
    return {
        "c_e_N_per_mm2": material.c_e,
        "alpha_per_ms": material.alpha,
        "shape": material.shape.name,
        **law_of(material),
    }


def material_of(constants: Mapping[str, Any], name: str, source: str = "") -> Material:
    """The material of `constants_of`; KeyError, TypeError or ValueError if they make none."""
    c_e, alpha, shape = (constants[key] for key in ("c_e_N_per_mm2", "alpha_per_ms", "shape"))
    law = {exponent: constants[exponent] for exponent in PAPER_LAW if exponent in constants}
    return Material(name, c_e=c_e, alpha=alpha, shape=shape, source=source, **law)


#: The paper's four materials, read-only. The units [N/mm^2] and [1/ms] and the parabolic f are our choices:
#: the paper states neither them nor its voxel size.
materials = Materials(*paper_materials())
#: Look of each of them in a figure of several, wherever it stands.
MATERIAL_LOOKS = dict(zip(("expert", "pettigrew", "bone", "pvc"), SERIES, strict=False))
