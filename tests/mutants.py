"""Do the tests notice faults? By hand and drawn at random, each with the quickest test files that run its function.

    python tests/mutants.py trace calls.json                  # functions that each test file runs, its time
    python tests/mutants.py run calls.json result.jsonl 1/2   # every second fault, from the first; resumes
    python tests/mutants.py compare before.jsonl after.jsonl

A fault is named by its function and an expression in it, so that it is found wherever the function moves; a
fault of the core by its line. For these the C++ tests run before the test files of the room.
"""

import ast
import json
import os
import resource
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

ROOT = Path(__file__).parents[1]
PACKAGE, TESTS = ROOT / "python/burrlab", ROOT / "tests/python"
FAULTS = [ROOT / "tests/golden" / name for name in ("faults.jsonl", "mutants.jsonl")]
MOST_FILES, MOST_SECONDS, PATIENCE = 4, 90.0, 300.0
CORE_TESTS = {
    "src": ["test_tick_reference.py", "test_hierarchy.py", "test_mean_field.py", "test_surface.py"],
    "kernel": ["test_tick_reference.py", "test_hierarchy.py"],
    "session": ["test_session.py", "test_session_faults.py"],
    "network": ["test_publisher.py", "test_replica.py"],
    "anatomy": ["test_watch.py", "test_structure_distance.py"],
    "effects": ["test_effects.py"],
}

# ---- what each test file runs ----

_ran: dict[int, CodeType] = {}


def _note(frame: FrameType, *_: object) -> None:
    _ran[id(frame.f_code)] = frame.f_code


def pytest_configure() -> None:
    if "MUTANTS_CALLS" in os.environ:
        threading.settrace(_note)
        sys.settrace(_note)


def pytest_unconfigure() -> None:
    if "MUTANTS_CALLS" in os.environ:
        sys.settrace(None)
        names = {code.co_qualname for code in _ran.values() if code.co_filename.startswith(str(PACKAGE))}
        Path(os.environ["MUTANTS_CALLS"]).write_text(json.dumps(sorted(names)))


def _pytest(files: list[str], package: Path, *options: str, **environment: str) -> tuple[int | None, float]:
    """Exit status, None after too long a time, and CPU seconds: other work on the machine does not count."""
    begun = _children_time()
    process = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *options, "-m", "not slow", *files],
        env={**os.environ, "PYTHONPATH": f"{package}{os.pathsep}{ROOT}/tests", "MPLBACKEND": "Agg", **environment},
        cwd=ROOT, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        return process.wait(
            PATIENCE * (10 if "MUTANTS_CALLS" in environment else 1)
        ), _children_time() - begun
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.wait()
        return None, _children_time() - begun


def _children_time() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _rows(file: str | Path) -> list[dict[str, Any]]:
    path = Path(file)
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def trace(out: str) -> None:
    path = Path(out).absolute()
    calls = json.loads(path.read_text()) if path.exists() else {}
    for file in sorted(TESTS.glob("test_*.py")):
        if file.name in calls:
            continue
        with tempfile.TemporaryDirectory() as folder:
            ran = Path(folder) / "ran.json"
            status, seconds = _pytest([str(file)], PACKAGE.parent, "-p", "mutants", MUTANTS_CALLS=str(ran))
            functions = json.loads(ran.read_text()) if ran.exists() and status == 0 else []
        calls[file.name] = {"seconds": round(seconds, 1), "functions": functions, "status": status}
        path.write_text(json.dumps(calls))
        print(file.name, status, round(seconds, 1), len(functions), flush=True)


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
        return _pytest([str(TESTS / name) for name in CORE_TESTS[path.parent.name]], package.parent)[0] != 0
    finally:
        copied.write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
        for core in PACKAGE.glob("_core*.so"):
            shutil.copy(core, package / core.name)


def run(calls_file: str, out: str, part: str = "1/1") -> None:
    calls, begin, step = json.loads(Path(calls_file).read_text()), *map(int, part.split("/"))
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
                    row["by"] = files = _chosen(calls, fault["function"], path.stem)
                    status = _pytest([str(TESTS / file) for file in files], package.parent)[0] if files else 0
                    row["caught"] = status != 0
                    shutil.copy(path, copied)
            with Path(out).open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(
                row["caught"],
                fault["function"],
                fault["before"],
                "->",
                fault["after"],
                *row["by"],
                flush=True,
            )


def _chosen(calls: dict[str, Any], function: str, module: str) -> list[str]:
    """Test files that run a function, the module's own and those first that run few others and are quick."""
    able = [name for name, one in calls.items() if function in one["functions"]]
    chosen: list[str] = []
    for name in sorted(
        able,
        key=lambda name: (module not in name, len(calls[name]["functions"]) * (10 + calls[name]["seconds"])),
    ):
        spent = sum(calls[one]["seconds"] for one in [*chosen, name])
        if len(chosen) < MOST_FILES and (not chosen or spent < MOST_SECONDS):
            chosen.append(name)
    return chosen


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
