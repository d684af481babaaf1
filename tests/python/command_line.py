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


def said(capsys, *words, status=0):
    """All that `burrlab WORDS` writes; it must end with this status."""
    code, out, err = call(capsys, *words)
    assert code == status, err
    return out + err
