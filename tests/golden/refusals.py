"""Every refusal in the tests: type and message of caught errors, exit status and message of commands.

REFUSALS=folder python -m pytest -p golden.refusals -m "not slow" tests/python  # each process writes its part
python tests/golden/refusals.py before after                                    # differences of two runs
"""

import contextlib
import io
import os
import re
import sys
from pathlib import Path
from typing import Any

_MOST = 300  # characters of a message; the rest quotes values
met: set[str] = set()


def masked(text: str) -> str:
    """The text in one line, without the folders and numbers of this run."""
    text = re.sub(r"(/[\w.+-]+)+/", "", text.replace("\n", " "))
    return re.sub(r"(?<![A-Za-z_])[+-]?(\d[\d,.e+-]*|nan|inf)", "#", text)[:_MOST]


def pytest_configure() -> None:
    from _pytest.raises import RaisesExc

    import burrlab.cli

    leave, run = RaisesExc.__exit__, burrlab.cli.main

    def caught(self: Any, kind: Any, error: Any, trace: Any) -> Any:
        if error is not None:
            met.add(masked(f"{type(error).__name__}: {error}"))
        return leave(self, kind, error, trace)

    def main(arguments: Any = None) -> int:
        status: int | str | None = 0
        try:
            with contextlib.redirect_stderr(io.StringIO()) as said:
                status = run(arguments)
            return status
        except SystemExit as ended:
            status = ended.code
            raise
        finally:
            sys.stderr.write(said.getvalue())
            if status:
                met.add(f"exit {status}: {masked(said.getvalue()).strip()}")

    RaisesExc.__exit__ = caught  # type: ignore[method-assign]
    burrlab.cli.main = sys.modules[run.__module__].main = main  # type: ignore[assignment,attr-defined]


def pytest_unconfigure() -> None:
    (Path(os.environ["REFUSALS"]) / f"{os.getpid()}.txt").write_text("\n".join(sorted(met)), encoding="utf-8")


def read(folder: str) -> set[str]:
    return {
        line for part in Path(folder).glob("*.txt") for line in part.read_text("utf-8").splitlines() if line
    }


if __name__ == "__main__":
    before, now = map(read, sys.argv[1:])
    gone, new = (
        (f"gone {line}" for line in sorted(before - now)),
        (f"new  {line}" for line in sorted(now - before)),
    )
    print(*gone, *new, sep="\n")
    sys.exit(before - now != set())
