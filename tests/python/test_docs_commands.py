"""The commands that the pages show are ones that the command line takes."""

from __future__ import annotations

import re
import shlex

import pytest
from conftest import ROOT

from burrlab.cli.main import command_parser, join_vectors

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def commands(text: str) -> list[str]:
    """Lines of their own, two in one apart; HOST:PORT stands for an address."""
    lines = re.findall(r"^(?: {4,8})?(burrlab .*)$", text, re.MULTILINE)
    parts = [part.strip() for line in lines for part in line.split(" #")[0].split(";")]
    return [part.replace("HOST:PORT", "localhost:18944") for part in parts if part.startswith("burrlab ")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_parse(page, capsys):
    for line in commands(page.read_text(encoding="utf-8")):
        try:
            command_parser().parse_args(join_vectors(shlex.split(line)[1:]))
        except SystemExit as stop:
            if stop.code:
                pytest.fail(f"{line}\n{capsys.readouterr().err}")


def test_pages_have_commands():
    found = {page.name: len(commands(page.read_text(encoding="utf-8"))) for page in PAGES}
    assert min(found[name] for name in ("README.md", "tissues.md", "view.md", "volumes.md", "web.md")) >= 2
