"""Do the tests notice faults? By hand and drawn at random, each with the quick tests that run its function.

    python tests/mutants.py trace calls.jsonl                 # functions that each test runs, its time: 12 minutes
    python tests/mutants.py run calls.jsonl result.jsonl 1/2  # every second fault, from the first; resumes
    python tests/mutants.py compare before.jsonl after.jsonl

A fault is named by its function and an expression in it, so that it is found wherever the function moves; a
fault of the core by its line. For these the C++ tests run before the test files of the room.
"""

import ast
import itertools
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
from collections.abc import Generator, Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE, TESTS = ROOT / "python/burrlab", ROOT / "tests/python"
FAULTS = [ROOT / "tests/golden" / name for name in ("faults.jsonl", "mutants.jsonl")]
MOST_SECONDS, PATIENCE = 90.0, 300.0
CORE_TESTS = {
    "src": ["test_tick_reference.py", "test_hierarchy.py", "test_mean_field.py", "test_surface.py"],
    "kernel": ["test_tick_reference.py", "test_hierarchy.py"],
    "session": ["test_session.py", "test_session_faults.py"],
    "network": ["test_publisher.py", "test_replica.py"],
    "anatomy": ["test_watch.py", "test_structure_distance.py"],
    "effects": ["test_effects.py"],
}

# ---- what each test runs ----

_ran: dict[int, CodeType] = {}


def _note(frame: FrameType, *_: object) -> None:
    _ran[id(frame.f_code)] = frame.f_code


def _write(**row: object) -> None:
    """A row with the package's functions that have run since the last."""
    names = {code.co_qualname for code in list(_ran.values()) if code.co_filename.startswith(str(PACKAGE))}
    _ran.clear()
    with (Path(os.environ["MUTANTS_CALLS"]) / str(os.getpid())).open("a") as file:
        file.write(json.dumps(row | {"functions": sorted(names)}) + "\n")


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
) -> Generator[None, object, object]:
    """What a fixture of a whole file runs counts for each of its tests."""
    if fixturedef.scope == "function":
        return (yield)
    before = dict(_ran)
    _ran.clear()
    made = yield
    _write(file=request.node.nodeid.partition("::")[0])
    _ran.update(before)
    return made


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    _ran.clear()
    begin = time.time()
    threading.settrace(_note)
    sys.settrace(_note)
    done = yield
    sys.settrace(None)
    _write(test=item.nodeid, seconds=round(time.time() - begin, 2))
    return done


def _pytest(tests: list[str], package: Path, *options: str, patience: float = PATIENCE) -> int | None:
    """Exit status, None after too long a time."""
    process = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, "-m", "not slow", *tests],
        env={**os.environ, "PYTHONPATH": f"{package}{os.pathsep}{ROOT}/tests", "MPLBACKEND": "Agg"},
        cwd=ROOT, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        return process.wait(patience)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.wait()
        return None


def _rows(file: str | Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in Path(file).read_text().splitlines()] if Path(file).exists() else []


def trace(out: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        os.environ["MUTANTS_CALLS"] = folder
        print("status", _pytest([], PACKAGE.parent, "-n", "2", "-p", "mutants", patience=20 * PATIENCE))
        Path(out).write_text("".join(part.read_text() for part in Path(folder).iterdir()))


# ---- faults ----


def _functions(tree: ast.AST, above: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """Each function with its qualified name; functions inside it are separate."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield above + node.name, node
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            inside = ".<locals>." if isinstance(node, ast.FunctionDef) else "."
            yield from _functions(node, above + node.name + inside)


def _expressions(function: ast.FunctionDef) -> Iterator[ast.expr]:
    """Expressions of a function's own body, without raised errors, f-strings and annotations."""

    def walk(node: ast.AST) -> Iterator[ast.expr]:
        if isinstance(
            node, ast.Raise | ast.JoinedStr | ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
        ):
            return
        if isinstance(node, ast.expr):
            yield node
        for name, value in ast.iter_fields(node):
            if name != "annotation":
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        yield from walk(child)

    for statement in function.body:
        yield from walk(statement)


def placed(fault: dict[str, Any]) -> tuple[Path, str]:
    """The file with the fault's function, and its text with the fault; LookupError if it is not found."""
    if fault["room"] == "core":
        for path in sorted((ROOT / "cpp/src").rglob("*.[ch]pp")):
            lines = path.read_text(encoding="utf-8").split("\n")
            for number, line in enumerate(lines):
                if line.strip() == fault["before"]:
                    return path, "\n".join([*lines[:number], fault["after"], *lines[number + 1 :]])
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if fault["function"].rpartition(".")[2] not in text:
            continue
        for name, function in _functions(ast.parse(text)):
            if name != fault["function"]:
                continue
            places = [node for node in _expressions(function) if ast.unparse(node) == fault["before"]]
            if len(places) > fault["nth"]:
                node, lines = places[fault["nth"]], text.encode().splitlines(keepends=True)
                begin, end = (
                    sum(map(len, lines[: line - 1])) + column
                    for line, column in (
                        (node.lineno, node.col_offset),
                        (node.end_lineno, node.end_col_offset),
                    )
                )
                whole = b"".join(lines)
                return path, (whole[:begin] + f"({fault['after']})".encode() + whole[end:]).decode()
    raise LookupError(f"{fault['function']} has no {fault['before']}")


def _core_notices(path: Path, text: str, folder: Path, package: Path) -> bool | None:
    """Whether the core's tests notice the fault; None if it does not compile. The build is incremental."""
    tree, build = folder / "core", folder / "build"
    jobs = [[sys.executable, "-m", "cmake", "--build", str(build)]]
    if not tree.exists():
        for part in ("cpp", "tests/cpp", "tests/fuzz", "tests/stubs", "CMakeLists.txt", "pyproject.toml"):
            copy_of = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
            (tree / part).parent.mkdir(parents=True, exist_ok=True)
            copy_of(ROOT / part, tree / part)
        eigen = Path(sysconfig.get_path("purelib")) / "cmeel.prefix"
        options = (
            "-DBURRLAB_TESTS=ON",
            "-DCMAKE_UNITY_BUILD=OFF",
            "-DCMAKE_BUILD_TYPE=Release",
            f"-DCMAKE_PREFIX_PATH={eigen}",
        )
        jobs.insert(
            0, [sys.executable, "-m", "cmake", "-S", str(tree), "-B", str(build), "-G", "Ninja", *options]
        )
    copied = tree / path.relative_to(ROOT)
    copied.write_text(text, encoding="utf-8")
    try:
        if any(subprocess.run(job, capture_output=True).returncode for job in jobs):
            return None
        ctest = [Path(sys.executable).with_name("ctest"), "--test-dir", build, "--timeout", "120"]
        if subprocess.run(ctest, capture_output=True).returncode:
            return True
        core = next((build / "cpp").glob("_core*"))
        shutil.copy(core, package / core.name)
        return (
            _pytest([str(TESTS / name) for name in CORE_TESTS[path.parent.name]], package.parent, "-x") != 0
        )
    finally:
        copied.write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
        for core in PACKAGE.glob("_core*.so"):
            shutil.copy(core, package / core.name)


def run(calls_file: str, out: str, part: str = "1/1") -> None:
    calls, begin, step = _rows(calls_file), *map(int, part.split("/"))
    faults = [fault for file in FAULTS for fault in _rows(file)][begin - 1 :: step]
    done = [row["fault"] for row in _rows(out)]
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder) / "burrlab"
        shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
        for fault in (fault for fault in faults if fault not in done):
            row: dict[str, Any] = {"fault": fault, "caught": None, "by": []}
            try:
                path, text = placed(fault)
            except LookupError as error:
                row["why"] = str(error)
            else:
                if fault["room"] == "core":
                    row["caught"] = _core_notices(path, text, Path(folder), package)
                else:
                    copied = package / path.relative_to(PACKAGE)
                    copied.write_text(text, encoding="utf-8")
                    row["by"] = tests = _chosen(calls, fault["function"], path.stem)
                    row["caught"] = bool(tests) and _pytest(tests, package.parent, "-x") != 0
                    shutil.copy(path, copied)
            with Path(out).open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(
                row["caught"],
                fault["function"],
                fault["before"],
                "->",
                fault["after"],
                len(row["by"]),
                flush=True,
            )


def _chosen(calls: list[dict[str, Any]], function: str, module: str) -> list[str]:
    """Tests that run a function: those of the module's own file first, then those that run few others and are quick.

    In the own file also the others, as tests may share what the first one has computed.
    """
    running = [row for row in calls if function in row["functions"]]
    own = {row["test"].partition("::")[0] for row in running if "test" in row}
    files = {row["file"] for row in running if "file" in row} | {file for file in own if module in file}
    able = [
        row for row in calls
        if "test" in row and (function in row["functions"] or row["test"].partition("::")[0] in files)
    ]  # fmt: skip
    able.sort(
        key=lambda row: (
            module not in row["test"].partition("::")[0],
            len(row["functions"]) * (0.1 + row["seconds"]),
        )
    )
    spent = itertools.accumulate(row["seconds"] for row in able)
    return [row["test"] for row in able[: 1 + sum(total < MOST_SECONDS for total in spent)]]


def compare(before: str, after: str) -> int:
    """Prints faults that only the first run caught, and the survivors by room; 1 if any fault was lost."""
    was, now = ({json.dumps(row["fault"]): row for row in _rows(file)} for file in (before, after))
    lost = [key for key, row in was.items() if row["caught"] and not now.get(key, {}).get("caught")]
    print(*(f"no longer caught: {key}" for key in lost), sep="\n")
    for room in sorted({row["fault"]["room"] for row in was.values()}):
        here = [
            [row["caught"] for row in rows.values() if row["fault"]["room"] == room] for rows in (was, now)
        ]
        survived, still = (f"{rows.count(False)} of {len(rows) - rows.count(None)}" for rows in here)
        print(f"{room}: {survived} survived, {still} now")
    return int(bool(lost))


if __name__ == "__main__":
    sys.exit({"trace": trace, "run": run, "compare": compare}[sys.argv[1]](*sys.argv[2:]))
