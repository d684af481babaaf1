"""Faces of packages: public names from a stub, imported at first use."""

import importlib.util
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def face(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package whose `__init__.pyi` lists its public names.

    Parameters
    ----------
    package, file : str
        `__name__` and `__file__` of the package.
    """
    stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    lines = re.findall(r"^from (\S+) import (\w+) as (\w+)$", stub, re.MULTILINE)
    places = {name: (module, known) for module, known, name in lines}

    def ask(name: str) -> Any:
        module, known = places.get(name, (package, name))
        if module != package:
            attribute = getattr(importlib.import_module(module), known)
        elif name.startswith("__") or importlib.util.find_spec(f"{package}.{name}") is None:
            raise AttributeError(
                f"module {package!r} has no attribute {name!r}", name=name, obj=sys.modules[package]
            )
        else:
            attribute = importlib.import_module(f"{package}.{name}")
        setattr(importlib.import_module(package), name, attribute)
        return attribute

    public = sorted(places)
    return ask, lambda: public, public
