"""The Python blocks of the pages on experiments, run as they stand, one after the other."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from conftest import ROOT


def blocks(page: str) -> list[str]:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize(
    "page",
    [
        "psychophysics.md",
        "simulated_subject.md",
        "experiment.md",
        "volumes.md",
        "tissues.md",
        "phantom.md",
        "effects.md",
        "anatomy.md",
        "view.md",
    ],
)
def test_blocks_run(page, tmp_path):
    found = blocks(page)
    assert len(found) > 0
    if page == "experiment.md":  # it needs a folder of answers; a device of one's own needs a terminal
        found = [block for block in found if "TerminalSeat" not in block]
        burrlab(tmp_path, "new", "experiment.toml")
        burrlab(
            tmp_path,
            "run",
            "experiment.toml",
            "--simulated",
            "--subject",
            "01",
            "--fast",
            "--task",
            "probing",
        )
    script = tmp_path / "page.py"
    script.write_text("\n".join(found), encoding="utf-8")
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def burrlab(folder, *words):
    subprocess.run(
        [sys.executable, "-m", "burrlab", "experiment", *words], cwd=folder, check=True, timeout=300
    )
