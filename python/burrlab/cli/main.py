"""The parser of `burrlab COMMAND` and its main function."""

import argparse
import contextlib
import importlib
import os
import re
import select
import sys
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

import burrlab
from burrlab.cli.commands import ACTIONS, COMMANDS, Command
from burrlab.cli.options import NotKept, add_options, check_outputs, sentence
from burrlab.common.check import nearest
from burrlab.common.files import NO_ROOM
from burrlab.starting import started

_QUIET = "--quiet"
_QUIET_HELP = "no progress, notes or warnings on standard error"
#: Options whose values may begin with a minus.
_SIGNED = ("--entry", "--axis", "--map", "--crop", "--offset", "--rotation")


class _Parser(argparse.ArgumentParser):
    def __init__(self, **options: Any) -> None:
        """Takes whole names only: an abbreviation may mean another option later."""
        super().__init__(allow_abbrev=False, **options)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse, but names a misspelt option before it asks for a missing one."""
        arguments = list(sys.argv[1:] if args is None else args)
        for text in [] if self._subparsers else arguments[: (arguments + ["--"]).index("--")]:
            name = text.partition("=")[0]
            if name.startswith("--") and name not in self._option_string_actions:
                self.error(f"unknown option {name}{nearest(name, self._option_string_actions)}")
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Prints one line that names the option, and exits with status 2."""
        if match := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            message += nearest(match[1], re.findall(r"[\w-]+", match[2]))
        if message.endswith("required: COMMAND"):
            message += f", one of {', '.join(self._actions[-1].choices or ())}"
        self.exit(2, f"{self.prog}: {message}\n")


def join_vectors(arguments: Sequence[str]) -> list[str]:
    """`--entry -1,2,3` as `--entry=-1,2,3`: argparse reads a leading minus as an option."""
    joined: list[str] = []
    for text in arguments:
        if joined and joined[-1] in _SIGNED and re.match(r"-[\d.]", text):
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
    parser.add_argument(_QUIET, action="store_true", help=f"of each command: {_QUIET_HELP}")
    for name, sub in _add_commands(parser, "command", COMMANDS).items():
        sub.epilog = f"{_QUIET}: {_QUIET_HELP}"
        if name == "experiment":
            _add_commands(sub, "action", ACTIONS)
    return parser


def _add_commands(parser: Any, kind: str, commands: Mapping[str, Command]) -> dict[str, Any]:
    added = parser.add_subparsers(dest=kind, required=True, metavar=kind.upper())
    for name, command in commands.items():
        add_options(added.add_parser(name, help=command.text, description=command.text), command.options)
    return dict(added.choices)


def _reader_left() -> bool:
    """Whether who reads standard output or error has gone, as in `burrlab ... | head -1`."""
    if not hasattr(select, "poll"):  # Windows
        return False
    ends = select.poll()
    for descriptor in (1, 2):
        ends.register(descriptor, 0)
    gone = [descriptor for descriptor, _ in ends.poll(0)]
    for descriptor in gone:
        os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)  # for what is still to be written
    return bool(gone)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; 0 is done (also without a number), 1 different or failed, 2 wrong input, 3 not saved
    as asked, 130 interrupted, 141 nobody reads."""
    options = argparse.Namespace(command="")
    if sys.stderr is None:  # it was closed
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    try:
        texts = join_vectors(sys.argv[1:] if arguments is None else arguments)
        words = [text for text in texts if text != _QUIET]
        options = command_parser().parse_args(words)
        run = getattr(
            importlib.import_module(f"burrlab.cli.{COMMANDS[options.command].module}"),
            f"do_{getattr(options, 'action', options.command)}",
        )
        started()
        check_outputs(options, words)
        with contextlib.ExitStack() as quiet:
            if words != texts:
                quiet.enter_context(contextlib.redirect_stderr(quiet.enter_context(open(os.devnull, "w"))))
            status = int(run(options) or 0)
        print(end="", flush=True)
        return status
    except (ValueError, OSError, ImportError) as error:
        if isinstance(error, BrokenPipeError) and _reader_left():
            return 141
        print(f"burrlab {options.command}: {sentence(error)}", file=sys.stderr)
        return 3 if isinstance(error, NotKept) or getattr(error, "errno", None) in NO_ROOM else 2
    except KeyboardInterrupt:
        print(f"burrlab {options.command}: interrupted", file=sys.stderr)
        return 130
    except SystemExit:
        with contextlib.suppress(BrokenPipeError):
            print(end="", flush=True)
        if _reader_left():
            return 141
        raise
