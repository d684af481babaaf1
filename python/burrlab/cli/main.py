"""The parser of `burrlab COMMAND` and its main function."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import burrlab
from burrlab.cli.bone import TISSUES_COMMAND
from burrlab.cli.descent import DESCENT_COMMANDS
from burrlab.cli.experiment import add_experiment_commands
from burrlab.cli.options import (
    JSON,
    SIGNED,
    Command,
    NotKept,
    Options,
    add_options,
    check_outputs,
    deliver,
    sentence,
)
from burrlab.cli.session import SESSION_COMMANDS
from burrlab.cli.view import VIEW_COMMAND
from burrlab.common.check import nearest
from burrlab.common.files import NO_ROOM
from burrlab.common.provenance import provenance
from burrlab.starting import started


class _Parser(argparse.ArgumentParser):
    def __init__(self, **options: Any) -> None:
        """Takes whole names only: an abbreviation may mean another option later."""
        super().__init__(allow_abbrev=False, **options)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse, but names a misspelt option before it asks for a missing one."""
        given = list(sys.argv[1:] if args is None else args)
        for text in [] if self._subparsers else given[: (given + ["--"]).index("--")]:
            name = text.partition("=")[0]
            if name.startswith("--") and name not in self._option_string_actions:
                self.error(f"unknown option {name}{nearest(name, self._option_string_actions)}")
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Prints one line that names the option, and exits with status 2."""
        if found := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            message += nearest(found[1], re.findall(r"[\w-]+", found[2]))
        if message.endswith("required: COMMAND"):
            message += f", one of {', '.join(self._actions[-1].choices or ())}"
        self.exit(2, f"{self.prog}: {message}\n")


def _version(options: Options) -> int:
    deliver(options, {"version": burrlab.__version__, **provenance()}, f"burrlab {burrlab.__version__}")
    return 0


def join_vectors(arguments: Sequence[str]) -> list[str]:
    """`--entry -1,2,3` as `--entry=-1,2,3`: argparse reads a leading minus as an option."""
    joined: list[str] = []
    for text in arguments:
        if joined and joined[-1] in SIGNED and re.match(r"-[\d.]", text):
            joined[-1] += f"={text}"
        else:
            joined.append(text)
    return joined


def command_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = _Parser(
        prog="burrlab", description="Virtual bone-burring experiments. Units: mm, N, s; dt in ms."
    )
    parser.add_argument("--version", action="version", version=f"burrlab {burrlab.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[Options], int], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(run=run)
        return sub

    def add(*described: Command) -> None:
        for one in described:
            add_options(command(one.name, one.run, one.text), one.options)

    add(*DESCENT_COMMANDS, *SESSION_COMMANDS, VIEW_COMMAND)
    add_experiment_commands(command)
    add(TISSUES_COMMAND, Command("version", _version, "Version and what it runs on.", (JSON,)))
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; 0 is done (also without a number), 1 different or failed, 2 wrong input, 3 not saved
    as asked, 130 interrupted."""
    started()
    options = argparse.Namespace(command="")
    try:
        given = join_vectors(sys.argv[1:] if arguments is None else arguments)
        options = command_parser().parse_args(given)
        check_outputs(options, given)
        return int(options.run(options))
    except (ValueError, OSError, ImportError) as error:
        print(f"burrlab {options.command}: {sentence(error)}", file=sys.stderr)
        return 3 if isinstance(error, NotKept) or getattr(error, "errno", None) in NO_ROOM else 2
    except KeyboardInterrupt:
        print(f"burrlab {options.command}: interrupted", file=sys.stderr)
        return 130
