"""A program in its own terminal, for tests that read its screen and press its keys."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

# Makes the terminal the process's own, so that Ctrl-C interrupts.
_ADOPT = "import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
BURRLAB = _ADOPT + "import sys; from burrlab.cli import main; sys.exit(main())"


class PseudoTerminal:
    """`python -c program arguments` in a pseudo-terminal; `received` holds all output."""

    def __init__(self, *arguments: str, program: str = BURRLAB, cwd: Path | None = None) -> None:
        self.controller, self.terminal = pty.openpty()
        self.before = termios.tcgetattr(self.terminal)
        self.received = b""
        self._read = 0
        self.process = subprocess.Popen(
            [sys.executable, "-c", program, *arguments],
            stdin=self.terminal, stdout=self.terminal, stderr=self.terminal, start_new_session=True, cwd=cwd,
            env={**os.environ, "TERM": "xterm", "COLUMNS": "80", "LINES": "24"},
        )  # fmt: skip

    def __enter__(self) -> PseudoTerminal:
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()
        os.close(self.controller)
        os.close(self.terminal)

    @property
    def text(self) -> str:
        """The output without escape sequences and line breaks."""
        plain = re.sub(rb"\x1b\[[0-9;?]*[A-Za-z]", b"", self.received).decode()
        return " ".join(plain.replace("\a", "").split())

    def look(self, seconds: float = 0.0) -> bool:
        """Reads new output; returns whether there was any."""
        if not select.select([self.controller], [], [], seconds)[0]:
            return False
        self.received += os.read(self.controller, 65536)
        return True

    def wait_for(self, *patterns: str, seconds: float = 30.0) -> str:
        """The first match after the last one found; fails after this time [s]."""
        end = time.monotonic() + seconds
        while True:
            new = self.received[self._read :].decode(errors="replace")
            found = [(match.start(), match) for p in patterns if (match := re.search(p, new))]
            if found:
                _, match = min(found, key=lambda pair: pair[0])
                self._read += len(new[: match.end()].encode())
                return match.group(0)
            if not self.look(0.05) and self.process.poll() is not None and not self.look(0.05):
                raise AssertionError(f"ended with {self.process.returncode} before {patterns}: {self.text}")
            if time.monotonic() > end:
                raise AssertionError(f"{patterns} did not come: {self.text}")

    def press(self, keys: str) -> None:
        os.write(self.controller, keys.encode())

    def end(self, seconds: float = 30.0) -> int:
        """Reads to the end of the program; returns its exit status."""
        end = time.monotonic() + seconds
        while self.process.poll() is None:
            self.look(0.05)
            assert time.monotonic() < end, f"it did not end: {self.text}"
        while self.look(0.05):
            pass
        return self.process.returncode

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        while self.look():
            pass
