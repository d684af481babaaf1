"""The plan of the rooms holds: imports lead to the left, stand at the top, and name modules in full."""

import ast
import runpy
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

HOUSE = runpy.run_path(str(Path(__file__).parents[2] / "examples/rooms.py"))
trees = cache(HOUSE["trees"])


@cache
def ties() -> dict[str, set[str]]:
    """Name of each module -> the modules that it imports."""
    return {
        name: {
            part
            for found in HOUSE["imported"](tree)
            for part in (found, found.rpartition(".")[0])
            if part in trees()
        }
        - {name, "burrlab"}
        for name, tree in trees().items()
    }


def test_imports() -> None:
    TopologicalSorter(ties()).prepare()  # no circles
    order, faces = (
        HOUSE["ROOMS"].index,
        ("burrlab", *map("burrlab.{}".format, ("anatomy", "effects", "psychophysics", "view", "volume"))),
    )
    for name, tree in trees().items():
        mine = HOUSE["room"](name)
        rooms = {HOUSE["room"](other) for other in ties()[name]} - {None}
        assert mine is None or all(order(other) <= order(mine) for other in rooms), (
            f"{name} imports from the right"
        )
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                assert not HOUSE["imported"](node), f"{name}: {node.name} imports"
            elif isinstance(node, ast.ImportFrom):
                named = node.level == 0 and (node.module not in faces or name == "burrlab.__main__")
                assert named, f"{name}, line {node.lineno}: imports a name that is not its module's"
