"""The rooms of the package and the imports between them: `python examples/rooms.py [architecture.png]`."""

from __future__ import annotations

import ast
import sys
from collections import Counter
from pathlib import Path

from matplotlib.patches import FancyBboxPatch

from burrlab.common.figures import REFERENCE, new_figure

PACKAGE = Path(__file__).parents[1] / "python" / "burrlab"
#: In the order of the work: each room imports only from those before it.
ROOMS = ("common", "theory", "bone", "measured", "descent", "fitting", "comparing", "planning", "anatomy", "session", "foreign", "effects", "view",
         "psychophysics", "cli")  # fmt: skip


def trees() -> dict[str, ast.Module]:
    """Name of each module -> its syntax tree."""
    names = {
        file: ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts)
        for file in PACKAGE.rglob("*.py")
    }
    return {
        name.removesuffix(".__init__"): ast.parse(file.read_text("utf-8")) for file, name in names.items()
    }


def imported(tree: ast.AST) -> set[str]:
    """Modules and names of burrlab that a tree imports; "." stands for a relative import."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names} if not node.level else {"."}
    return {name for name in found if name.split(".")[0] in ("burrlab", "")}


def room(module: str) -> str | None:
    """The room of a module; None for the faces and `_core`."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in ROOMS else None


def text_alone(node: ast.stmt) -> bool:
    """Whether a statement is a docstring."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def draw(path: str) -> None:
    arrows, sizes = Counter(), Counter()
    for name, tree in trees().items():
        if (mine := room(name)) is None:
            continue
        sizes[mine] += sum(isinstance(node, ast.stmt) and not text_alone(node) for node in ast.walk(tree))
        theirs = {room(other) for other in imported(tree)} - {None, mine, "common"}  # all rooms import common
        arrows.update((mine, other) for other in theirs)
    figure = new_figure(11.8, 3.0)
    ax = figure.subplots()
    x = {name: 1.5 * i for i, name in enumerate(ROOMS)}
    for (importer, other), modules in sorted(arrows.items()):
        ax.annotate(
            "", (x[other], 0.34), (x[importer], 0.34), zorder=1,
            arrowprops={"arrowstyle": "-|>", "color": REFERENCE, "alpha": 0.55, "linewidth": 0.5 + 0.22 * modules,
                        "connectionstyle": "arc3,rad=0.42", "shrinkA": 2, "shrinkB": 2},
        )  # fmt: skip
    for name in ROOMS:
        ax.add_patch(
            FancyBboxPatch((x[name] - 0.62, -0.3), 1.24, 0.6, "round,pad=0.04", fc="#dbe9f6", ec=REFERENCE)
        )
        ax.text(x[name], 0.06, name, ha="center", va="center", fontsize=min(9, 68 / len(name)))
        ax.text(x[name], -0.15, sizes[name], ha="center", va="center", fontsize=8, color=REFERENCE)
    ax.set(xlim=(-0.8, x["cli"] + 0.8), ylim=(-0.5, 2.7))
    ax.set_title(
        "Rooms of burrlab: an arrow leads from a room to one that it imports, and its width says how many "
        "modules do; all import common; below a name: its statements",
        fontsize=9,
    )
    ax.set_axis_off()
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    draw(sys.argv[1] if len(sys.argv) > 1 else "architecture.png")
