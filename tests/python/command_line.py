"""Runs a command in this process, as a shell sees it."""

from __future__ import annotations

from burrlab.cli import main


def call(capsys, *words):
    """Exit status, standard output and standard error of `burrlab WORDS`."""
    try:
        code = main(list(map(str, words)))
    except SystemExit as stop:
        code = stop.code
    return code, *capsys.readouterr()
