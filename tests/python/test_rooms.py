"""The plan of the rooms holds: imports lead to the left, stand at the top, and name modules in full."""

import ast
import runpy
from graphlib import TopologicalSorter
from pathlib import Path

HOUSE = runpy.run_path(str(Path(__file__).parents[2] / "examples/rooms.py"))
FACED = ("anatomy", "effects", "psychophysics", "view", "volume")
TREES = HOUSE["trees"]()
TIES = {
    name: {
        part
        for found in HOUSE["imported"](tree)
        for part in (found, found.rpartition(".")[0])
        if part in TREES
    }
    - {name, "burrlab"}
    for name, tree in TREES.items()
}


def test_no_circles() -> None:
    TopologicalSorter(TIES).prepare()


def test_imports() -> None:
    order, faces = HOUSE["ROOMS"].index, ("burrlab", *(f"burrlab.{one}" for one in FACED))
    for name, tree in TREES.items():
        mine = HOUSE["room"](name)
        rooms = {HOUSE["room"](other) for other in TIES[name]} - {None}
        assert mine is None or all(order(other) <= order(mine) for other in rooms), (
            f"{name} imports from the right"
        )
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                assert not HOUSE["imported"](node), f"{name}: {node.name} imports"
            elif isinstance(node, ast.ImportFrom):
                named = node.level == 0 and (node.module not in faces or name == "burrlab.__main__")
                assert named, f"{name}, line {node.lineno}: imports a name that is not its module's"
