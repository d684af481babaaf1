"""Runs a command in this process, as a shell sees it."""

from __future__ import annotations

import json

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


def refusal(capsys, *words):
    """What a command says that is refused: status 2, one line, and nothing on standard output."""
    code, out, err = call(capsys, *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    return err


def result(capsys, *words):
    """What a command that ends well writes as JSON."""
    code, out, _ = call(capsys, *words, "--json", "-")
    assert code == 0
    return json.loads(out)
