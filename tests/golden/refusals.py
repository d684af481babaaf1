"""Every refusal that the tests meet: type and message of what `pytest.raises` catches, exit status and sentence of commands.

REFUSALS=folder python -m pytest -p golden.refusals -m "not slow" tests/python     # each process writes its part
python tests/golden/refusals.py folder                                             # against refusals.txt
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from pathlib import Path
from typing import Any

FROZEN = Path(__file__).with_name("refusals.txt")
_MOST = 300  # characters: what follows quotes the value
met: set[str] = set()


def masked(text: str) -> str:
    """In one line, without the folders and numbers of this run."""
    text = re.sub(r"(/[\w.+-]+)+/", "", text.replace("\n", " "))
    return re.sub(r"(?<![A-Za-z_])[+-]?(\d[\d,.e+-]*|nan|inf)", "#", text)[:_MOST]


class _Tee(io.StringIO):
    """Keeps what it passes on."""

    def __init__(self, file: Any) -> None:
        super().__init__()
        self.file, self.text = file, ""

    def write(self, text: str) -> int:
        self.text += text
        return int(self.file.write(text))


def pytest_configure() -> None:
    from _pytest.raises import RaisesExc

    import burrlab.cli
    import burrlab.cli.main

    leave, run = RaisesExc.__exit__, burrlab.cli.main.main

    def caught(self: Any, kind: Any, error: Any, trace: Any) -> Any:
        if error is not None:
            met.add(masked(f"{type(error).__name__}: {error}"))
        return leave(self, kind, error, trace)

    def main(arguments: Any = None) -> int:
        said, status = _Tee(sys.stderr), 0
        try:
            with contextlib.redirect_stderr(said):
                status = run(arguments)
            return status
        except SystemExit as ended:
            status = int(ended.code or 0)
            raise
        finally:
            if status:
                met.add(f"exit {status}: {masked(said.text).strip()}")

    RaisesExc.__exit__ = caught  # type: ignore[method-assign]
    burrlab.cli.main = burrlab.cli.main.main = main


def pytest_unconfigure() -> None:
    (Path(os.environ["REFUSALS"]) / f"{os.getpid()}.txt").write_text("\n".join(sorted(met)), encoding="utf-8")


if __name__ == "__main__":
    now = {
        line
        for part in Path(sys.argv[1]).glob("*.txt")
        for line in part.read_text(encoding="utf-8").splitlines()
    } - {""}
    if not FROZEN.exists():
        FROZEN.write_text("\n".join(sorted(now)) + "\n", encoding="utf-8")
    before = set(FROZEN.read_text(encoding="utf-8").splitlines())
    print(
        *(f"gone {line}" for line in sorted(before - now)),
        *(f"new  {line}" for line in sorted(now - before)),
        sep="\n",
    )
    sys.exit(before - now != set())
