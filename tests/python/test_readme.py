"""What the README shows, runs."""

from __future__ import annotations

import re
import shlex

import pytest
from conftest import ROOT

from burrlab.cli import main

README = (ROOT / "README.md").read_text()


def test_script(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    first, second, third = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(first, "README.md", "exec"), {})
    assert "[[Variables]]" in capsys.readouterr().out
    assert {p.name for p in tmp_path.iterdir()} == {"descent.png", "curve.csv", "fit.png", "region.png"}
    exec(compile(second, "README.md", "exec"), {})
    said = capsys.readouterr().out
    assert "Replay(equal, 5000 ticks" in said
    assert "path length" in said
    exec(compile(third, "README.md", "exec"), {})
    said = capsys.readouterr().out
    assert "facial nerve" in said
    assert "of bone removed; Dice" in said


def test_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    commands = block.strip().splitlines()
    assert len(commands) >= 9
    for line in commands:
        name, *arguments = shlex.split(line)
        assert name == "burrlab"
        assert main(arguments) == 0, line


def test_make_targets_exist():
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"(?:^ {4}|[`(;] ?)make ([a-z-]+)", README, re.MULTILINE))
    assert {"demo", "test", "test-slow", "figures"} <= targets
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


@pytest.mark.parametrize("link", re.findall(r"\]\(([^)#:]+)\)", README))
def test_links(link):
    assert (ROOT / link).is_file()
