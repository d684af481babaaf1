"""What is shown beside a session or a replica on the command line: a window or a page."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from burrlab._core import Replica
from burrlab.cli import Options
from burrlab.session.session import Session


def add_live_options(command: argparse.ArgumentParser, port: Callable[[str], int]) -> None:
    """`--view` and `--web`."""
    shown = command.add_mutually_exclusive_group()
    shown.add_argument("--view", action="store_true", help="show it in a window (extra viz3d)")
    shown.add_argument(
        "--web", type=port, nargs="?", const=0, metavar="PORT",
        help="show it in a web page on this machine, until Ctrl-C (extra viz3d); default any free port; there is no authentication",
    )  # fmt: skip


def check_live(options: Options) -> None:
    """Before anything is started: ImportError without an extra, OSError without a screen or where the port is taken."""
    if options.view or options.web is not None:
        from burrlab.view.rendering import check_screen, pyvista

        pyvista()
        if options.view:
            check_screen()
            return
        from burrlab.view.web import check_page

        check_page(port=options.web)


def show_live(options: Options, source: Session | Replica, say: Callable[[str], object]) -> None:
    """A window until it is closed or the session ends, or a page until Ctrl-C, which ends both: KeyboardInterrupt."""
    if options.view:
        from burrlab.view.live import LiveView

        view = LiveView(source)
        try:
            view.run()
        finally:
            view.close()
    elif options.web is not None:
        from burrlab.view.web import serve, warning

        serve(source, port=options.web, on_ready=lambda address: say(warning(address)))
        if not source.wait(0.0):
            raise KeyboardInterrupt
