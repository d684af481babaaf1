"""Runs commands in this process, as in a shell."""

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
    """All that `burrlab WORDS` writes; the command must end with this status."""
    code, out, err = call(capsys, *words)
    assert code == status, err
    return out + err


def refusal(capsys, *words):
    """The message of a refused command: status 2, one line, and nothing on standard output."""
    code, out, err = call(capsys, *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    return err


def result(capsys, *words):
    """The JSON of a command that succeeds."""
    code, out, _ = call(capsys, *words, "--json", "-")
    assert code == 0
    return json.loads(out)
