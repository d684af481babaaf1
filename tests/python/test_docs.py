"""Examples, and scripts and commands of the README and the pages, run, and links lead somewhere."""

import json
import re
import runpy
import shlex
import sys
import textwrap
import tomllib
from pathlib import Path

import pytest
from conftest import ROOT

import burrlab
from burrlab.cli import main
from burrlab.cli.main import command_parser, join_vectors

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
TEXTS = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
README = TEXTS["README.md"]


def blocks(page: str, language: str = "python") -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", TEXTS[page], re.MULTILINE | re.DOTALL)


def run(name: str, *scripts: str) -> None:
    exec(compile("\n".join(scripts), name, "exec"), {"__name__": "__main__"})


def test_script_of_the_readme(here, capsys):
    rows = "0,5;78,5;Bär\n1,0;498;Bär\n1,2;798;Bär\n1,6;1.660,5;Ito\n2,0;2.750,0;Ito\n"
    Path("lab.csv").write_text(f"Kraft [N];v (µm/s);Bediener\n{rows}", encoding="cp1252")
    (own,) = blocks("README.md")
    run("README.md", own)
    assert {p.name for p in here.iterdir()} == {"lab.csv", "fit.png", "region.png"}
    said = capsys.readouterr().out
    assert (
        "VelocityCurve(5 rows, 5 with a velocity, 0.5..2 N, 'lab.csv'; force from Kraft [N] in N, velocity from v"
        in said
    )
    assert "[[Variables]]" in said


def test_program_of_the_readme():
    """`make cpp` compiles and runs it."""
    (core,) = blocks("README.md", "cpp")
    assert textwrap.indent(core, "  ") in (ROOT / "examples/cpp/tick.cpp").read_text(encoding="utf-8")


def test_commands_of_the_readme(here):
    """They run, and the fit recovers the material of the sweep."""
    told = [shlex.split(line) for line in commands("README.md") if "ct.nrrd" not in line]
    assert len(told) >= 10
    for name, *arguments in told:
        assert (name, main(arguments)) == ("burrlab", 0), arguments
    fit, bone = burrlab.Fit.from_json("fit.json"), burrlab.materials["bone"]
    assert bone.c_e in fit.intervals["c_e"][95]
    assert bone.alpha in fit.intervals["alpha"][95]


def test_claims_of_the_paper():
    """The page's table is the last output of its notebook."""
    notebook = json.loads((ROOT / "notebooks/00_paper.ipynb").read_text(encoding="utf-8"))
    assert "".join(notebook["cells"][-1]["outputs"][0]["data"]["text/markdown"]) in TEXTS["paper.md"]


@pytest.mark.slow
def test_commands_of_the_paper(here):
    """Those of the README take the same ways."""
    told = commands("paper.md")
    assert len(told) >= 8
    assert {line: main(shlex.split(line)[1:]) for line in told} == dict.fromkeys(told, 0)


@pytest.mark.parametrize(
    "name",
    [
        "psychophysics",
        "simulated_subject",
        "experiment",
        "volumes",
        "tissues",
        pytest.param("phantom", marks=pytest.mark.slow),  # examples/phantom.py is like it
        "effects",
        "anatomy",
        "view",
        "fit",
        "session",
        "index",
    ],
)
def test_blocks_run(name, here):
    """The blocks of a page run one after the other."""
    found = [block for block in blocks(f"{name}.md") if "TerminalSeat" not in block]  # needs a terminal
    assert found
    burrlab.VelocityCurve([0.5, 1.0, 1.5, 2.0], [0.08, 0.5, 1.25, 2.3]).to_csv("lab.csv")
    if name == "experiment":  # its blocks need answers
        simulated = "--simulated --subject 01 --fast --task probing"
        for line in ("new experiment.toml", f"run experiment.toml {simulated}"):
            assert main(["experiment", *line.split()]) == 0
    run(f"{name}.md", *found)


def commands(page: str) -> list[str]:
    """Commands on separate lines or between semicolons; HOST:PORT becomes an address."""
    pattern = r"`(burrlab [^`]*)`" if page in ("README.md", "paper.md") else r"^(?: {4,8})?(burrlab .*)$"
    parts = [
        part.strip()
        for line in re.findall(pattern, TEXTS[page], re.MULTILINE)
        for part in line.split(" #")[0].split(";")
    ]
    return [part.replace("HOST:PORT", "localhost:18944") for part in parts if part.startswith("burrlab ")]


@pytest.mark.parametrize("page", TEXTS)
def test_commands_parse(page, capsys):
    for line in commands(page):
        try:
            command_parser().parse_args(join_vectors(shlex.split(line)[1:]))
        except SystemExit as stop:
            if stop.code:
                pytest.fail(f"{line}\n{capsys.readouterr().err}")


def test_pages_have_commands():
    assert min(len(commands(f"{name}.md")) for name in ("README", "tissues", "view", "volumes", "web")) >= 2


def test_make_targets_exist():
    targets = set(re.findall(r"(?:^ {4}|[`(;] ?)make ([a-z-]+)", README, re.MULTILINE))
    assert {"demo", "test", "test-slow", "figures"} <= targets
    assert targets <= set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


def test_the_version_is_that_of_pyproject():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    newest = re.search("^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert (burrlab.__version__, newest and newest[1]) == (version, version)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links(page: Path) -> None:
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", TEXTS[page.name])
    assert not [link for link in links if not (page.parent / link).is_file()]
    assert not re.findall("^%.*", TEXTS[page.name], re.MULTILINE)  # a comment to the site


_RUN_ELSEWHERE = {"experiment_driver.py", "demo.py"}  # by test_experiment_live.py and by `make demo`
_ARGUMENTS = {
    "grid_independence.py": ["grid.png", "--fast"],
    "session_leader.py": ["trace.h5", "--seconds", "2", "--port", "0"],
    "session_driver.py": ["--seconds", "2"],
}


@pytest.mark.parametrize(
    "script",
    [
        pytest.param(name, marks=pytest.mark.slow if name == "offsets.py" else ())
        for name in sorted({p.name for p in (ROOT / "examples").glob("*.py")} - _RUN_ELSEWHERE)
    ],
)
def test_examples_run(script, here, monkeypatch):
    monkeypatch.setattr(sys, "argv", [script, *_ARGUMENTS.get(script, [])])
    runpy.run_path(str(ROOT / "examples" / script), run_name="__main__")
    figures = list(here.rglob("*.png"))
    assert figures or script.startswith("session_")
    assert all(figure.stat().st_size > 10_000 for figure in figures)
