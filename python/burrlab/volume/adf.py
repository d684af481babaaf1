"""The YAML file that places a stack of slices in the simulator volumetric_drilling (AMBF's description format, ADF)."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.bounds import shown

#: Sides of a volume that are taken for a head or a part of one [mm] (ours).
PLAUSIBLE = (2.0, 500.0)
_METRE = 1000.0
#: Bytes of a description, and keys of one mapping in it; theirs have 2 kB (ours).
_LONGEST = 300_000
#: What older files of volumetric_drilling call one unit: 0.049664 m (a comment in them).
_OLD_UNIT = 49.664


@dataclass(frozen=True, eq=False)
class StackDescription:
    """What the file says.

    Attributes
    ----------
    folder : Path
        Of the slices.
    prefix : str
        Before the number in the slices' names.
    count : int or None
        Most slices that the simulator loads.
    extent : ndarray, shape (3,)
        Sides of the volume (x, y, z) [mm].
    """

    folder: Path
    prefix: str
    count: int | None
    extent: NDArray[np.float64]


def read_description(path: str | os.PathLike[str], *, unit: float | None = None) -> StackDescription:
    """Reads the description of a stack.

    Parameters
    ----------
    path : path-like
        A YAML file with a block `VOLUME name` that has `dimensions` (x, y, z), perhaps `scale`, and `images` (path, prefix,
        format, count), as in LCSR-SICKKIDS/volumetric_drilling.
    unit : float, optional
        Of the dimensions [mm]; default a metre, checked for plausibility.

    Raises
    ------
    ImportError
        Without PyYAML (extra `medical`).
    OSError
        If the file cannot be read.
    ValueError
        If it is no such description, or no head has these sides.
    """
    name = os.fspath(path)
    block = _volume_block(name, _content(name))
    images = _part(name, block, "images", dict)
    if str(images.get("format", "png")).lower().lstrip(".") != "png":
        raise ValueError(f"{name}: images: format must be png, got {shown(images.get('format'))}")
    folder = Path(name).parent / str(_part(name, images, "path", str, within="images: "))
    count = images.get("count")
    if count is not None and (not isinstance(count, int) or isinstance(count, bool) or count < 1):
        raise ValueError(f"{name}: images: count must be a whole number from 1, got {shown(count)}")
    dimensions = _part(name, block, "dimensions", dict)
    sides = np.array([_positive(name, f"dimensions: {axis}", dimensions.get(axis)) for axis in "xyz"])
    sides *= _positive(name, "scale", block.get("scale", 1.0))
    if unit is not None:
        return StackDescription(
            folder, str(images.get("prefix", "")), count, sides * _positive(name, "unit", unit)
        )
    _check_plausible(name, sides)
    return StackDescription(folder, str(images.get("prefix", "")), count, sides * _METRE)


def _content(name: str) -> Any:
    try:
        import yaml
    except ImportError as error:
        raise ImportError("reading YAML needs PyYAML: pip install 'burrlab[medical]'") from error
    with open(name, "rb") as file:
        content = file.read(_LONGEST + 1)
    if len(content) > _LONGEST:
        raise ValueError(f"{name}: a description must have at most {_LONGEST} bytes")
    try:
        loader = yaml.SafeLoader(content)
        merge = loader.flatten_mapping

        def bounded(node: Any) -> None:
            merge(node)
            if len(node.value) > _LONGEST:
                raise yaml.YAMLError(f"a mapping must have at most {_LONGEST} keys, merged ones included")

        loader.flatten_mapping = bounded
        return loader.get_single_data()
    except (
        yaml.YAMLError,
        ValueError,
        RecursionError,
        LookupError,
        TypeError,
        AttributeError,
        OverflowError,
    ) as error:
        raise ValueError(f"{name}: not a YAML file: {' '.join(str(error).split())}") from None


def _volume_block(name: str, content: Any) -> dict[str, Any]:
    blocks = {}
    if isinstance(content, dict):
        blocks = {key: block for key, block in content.items() if str(key).startswith("VOLUME ")}
    if len(blocks) != 1:
        found = ", ".join(map(str, blocks))[:200] or "none"
        raise ValueError(f"{name}: must have one block 'VOLUME name' that describes a stack, got {found}")
    [(key, block)] = blocks.items()
    if not isinstance(block, dict):
        raise ValueError(f"{name}: {str(key)[:200]} must have dimensions and images, got {shown(block)}")
    return block


def _part(name: str, block: dict[str, Any], key: str, kind: type, *, within: str = "") -> Any:
    value = block.get(key)
    if not isinstance(value, kind):
        what = "a block" if kind is dict else "a text"
        raise ValueError(f"{name}: {within}{key} must be there, {what}, got {shown(value)}")
    return value


def _positive(name: str, what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < math.inf:
        raise ValueError(f"{name}: {what} must be a finite number above 0, got {shown(value)}")
    return float(value)


def _check_plausible(name: str, sides: NDArray[np.float64]) -> None:
    low, high = PLAUSIBLE

    def plausible(unit: float) -> bool:
        return bool(np.all((sides * unit >= low) & (sides * unit <= high)))

    if plausible(_METRE):
        return
    others = [
        ("millimetres", 1.0),
        ("centimetres", 10.0),
        ("units of 0.049664 m, as in older files of the simulator", _OLD_UNIT),
    ]
    would = "; ".join(
        f"in {what} {_sides(sides * unit)} mm (unit={unit:g})" for what, unit in others if plausible(unit)
    )
    raise ValueError(
        f"{name}: dimensions in metres would be {_sides(sides * _METRE)} mm, and a head or a part of one has sides of {low:g} to "
        f"{high:g} mm; {would or 'in no usual unit it would be one'}: give unit= [mm]"
    )


def _sides(sides: NDArray[np.float64]) -> str:
    return " x ".join(f"{side:.4g}" for side in sides)
