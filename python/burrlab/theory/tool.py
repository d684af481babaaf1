"""A burr and the material that it cuts, as arguments, and the law of a material."""

from typing import Any

from burrlab._core import Burr, Material
from burrlab.common.check import require_type


def require_tool(burr: object, *materials: object) -> None:
    """TypeError unless these are a Burr and, if given, a Material."""
    require_type("burr", burr, Burr, "Burr(3.0)")
    for material in materials:
        require_type("material", material, Material, "materials['bone']")


#: Exponents of the paper's law (Eq. 3 and 4). Files and keys of stores hold those of another law only.
PAPER_LAW = {"force_exponent": 1.5, "rate_exponent": 0.0}


def law_of(owner: Any) -> dict[str, float]:
    """The exponents of a material or law that are not the paper's."""
    law = {name: getattr(owner, name) for name in PAPER_LAW}
    return {name: exponent for name, exponent in law.items() if exponent != PAPER_LAW[name]}
