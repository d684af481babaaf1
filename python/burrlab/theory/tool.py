"""A burr and the material that it cuts, as arguments."""

from burrlab._core import Burr, Material
from burrlab.common.check import require_type


def require_tool(burr: object, *materials: object) -> None:
    """TypeError unless these are a Burr and, if given, a Material."""
    require_type("burr", burr, Burr, "Burr(3.0)")
    for material in materials:
        require_type("material", material, Material, "materials['bone']")
