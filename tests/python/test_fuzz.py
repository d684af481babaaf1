"""The readers under hostile files (tests/fuzz): what was ever found, and two seconds more each; and that the test finds."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[1] / "fuzz"
TARGETS = re.findall(r'^    "(\w+)": \(', (FUZZ / "readers.py").read_text(), re.MULTILINE)
BAD = """
import os, time
PACKAGE = "/nowhere"
def read(name):
    if open(name, "rb").read() != b"seed 1\\n":
        {}
TARGETS = {{"bad": (read, [lambda at: (at / "in.csv").write_text("seed 1\\n")])}}
"""


def fuzz(folder: Path, target: str, seconds: float, out: Path) -> tuple[int, str]:
    command = [sys.executable, folder / "fuzz.py", target, f"--seconds={seconds}", f"--out={out}"]
    done = subprocess.run(command, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr + "".join(p.read_text() for p in out.glob("*/*.txt"))


@pytest.mark.parametrize("target", TARGETS)
def test_what_was_found_and_two_seconds_more(target: str, tmp_path: Path) -> None:
    status, told = fuzz(FUZZ, target, 2.0, tmp_path)
    assert status == 0, told


@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("os.abort()", "ends--6"),
        ("time.sleep(60)", "hangs"),
        ("bytearray(5 << 29)", "MemoryError-readers-read"),
        ("raise ValueError('one\\ntwo')", "ValueError-readers-read"),
        ("os.write(2, b'libthing: error 7')", "said-libthing-error"),
    ],
)
def test_a_reader_that_does_what_none_may_is_found(what: str, name: str, tmp_path: Path) -> None:
    for file in ("fuzz.py", "mutations.py"):
        shutil.copy(FUZZ / file, tmp_path)
    (tmp_path / "readers.py").write_text(BAD.format(what))
    status, told = fuzz(tmp_path, "bad", 0.2, tmp_path / "out")
    assert status == 1, told
    assert re.search(rf"^bad: \d+ inputs, 1 findings {name}$", told, re.MULTILINE)
    assert (tmp_path / "out" / "bad" / name / "in.csv").is_file()
