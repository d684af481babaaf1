"""Readers under hostile files (tests/fuzz): earlier findings and a moment more; and the test itself."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[1] / "fuzz"
TARGETS = re.findall(r'^    "(\w+)": \(', (FUZZ / "readers.py").read_text(), re.MULTILINE)
BAD = {
    "ends": ("os.abort()", "ends--6"),
    "hangs": ("time.sleep(60)", "hangs"),
    "fills": ("bytearray(5 << 29)", "MemoryError-readers-read"),
    "talks": ("raise ValueError('one\\ntwo')", "ValueError-readers-read"),
    "prints": ("os.write(2, b'libthing: error 7')", "said-libthing-error"),
}
READERS = "import os, time\nPACKAGE, TARGETS = '/nowhere', {}\nSEEDS = [lambda at: (at / 'in.csv').write_text('seed 1')]\n"
READER = """
def read(name):
    if open(name, "rb").read() != b"seed 1":
        {what}
TARGETS["{name}"] = read, SEEDS
"""


def fuzz(folder: Path, *targets: str, seconds: float, out: Path) -> tuple[int, str]:
    command = [sys.executable, folder / "fuzz.py", *targets, f"--seconds={seconds}", f"--out={out}"]
    done = subprocess.run(command, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr + "".join(p.read_text() for p in out.glob("*/*.txt"))


@pytest.mark.parametrize("half", [TARGETS[::2], TARGETS[1::2]], ids=["even", "odd"])
def test_earlier_findings_and_a_moment_more(half: list[str], tmp_path: Path) -> None:
    status, told = fuzz(FUZZ, *half, seconds=0.1, out=tmp_path)
    assert status == 0, told
    assert re.findall(r"^(\w+): \d+ inputs, 0 findings$", told, re.MULTILINE) == half


def test_readers_that_do_what_none_may_are_found(tmp_path: Path) -> None:
    for file in (FUZZ / "fuzz.py", FUZZ / "mutations.py", Path(__file__).with_name("wire.py")):
        shutil.copy(file, tmp_path)
    made = [READER.format(name=name, what=what) for name, (what, _) in BAD.items()]
    (tmp_path / "readers.py").write_text("".join([READERS, *made]))
    status, told = fuzz(tmp_path, seconds=0.2, out=tmp_path / "out")
    assert status == 1, told
    for name, (_, finding) in BAD.items():
        assert re.search(rf"^{name}: \d+ inputs, 1 findings {finding}$", told, re.MULTILINE), told
        assert (tmp_path / "out" / name / finding / "in.csv").is_file()
