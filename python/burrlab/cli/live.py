"""What is shown beside a session or a replica on the command line: a window or a page."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from burrlab._core import Replica
from burrlab.cli.options import Options, port, refuse_options
from burrlab.session.session import Session

if TYPE_CHECKING:
    from burrlab.effects import Companion


def add_live_options(command: argparse.ArgumentParser) -> None:
    """`--view` and `--web`, and what is shown there."""
    shown = command.add_mutually_exclusive_group()
    shown.add_argument("--view", action="store_true", help="show it in a window (extra viz3d)")
    shown.add_argument(
        "--web", type=port, nargs="?", const=0, metavar="PORT",
        help="show it in a web page on this machine, until Ctrl-C (extra viz3d); default any free port; whoever has the address that is printed can work it",
    )  # fmt: skip
    command.add_argument(
        "--effects", action="store_true", default=None,
        help="dust, blood and, from a nozzle beside the burr, water, at assumed rates; with --view or --web",
    )  # fmt: skip
    command.add_argument(
        "--stereo", action="store_true", default=None,
        help="both eyes side by side; with --view or --web, whose page has a switch for it",
    )  # fmt: skip


def check_live(options: Options) -> None:
    """Before anything is started: ValueError for an option that nothing would look at, ImportError without an extra,
    OSError without a screen or where the port is taken."""
    if not options.view and options.web is None:
        refuse_options(options, ("effects", "stereo"), "goes with --view or --web")
    else:
        from burrlab.view.rendering import check_screen, pyvista

        pyvista()
        if options.view:
            check_screen()
            return
        from burrlab.view.web import check_page

        check_page(port=options.web)


def start_effects(options: Options, source: Session | Replica) -> Companion | None:
    """Those that were asked for, with the session's seed, from now to its end."""
    if not options.effects:
        return None
    from burrlab.effects import Companion, Nozzle

    seed = source.seed if isinstance(source, Session) else int(json.loads(source.hello)["seed"])
    return Companion(source, seed=seed, nozzle=Nozzle()).start()


def end_effects(effects: Companion | None) -> tuple[str, dict[str, Any]]:
    """What there is to say of them after the end of what they were beside, for people and for JSON; nothing of None."""
    if effects is None:
        return "", {}
    effects.wait(2.0)  # for the last frame
    effects.stop()
    report, balance = effects.report(), effects.balance()
    lines = [f"effects at assumed rates, seed {effects.seed}: {report}"]
    if effects.error:
        lines.append(f"effects ended early: {effects.error}")
    lines += [f"{name}: {account}" for name, account in balance.items()]
    accounts = {name: {**account.volumes(), "exact": account.exact} for name, account in balance.items()}
    plain = {"seed": effects.seed, "error": effects.error, **report.to_dict(), "balance_mm3": accounts}
    return "\n" + "\n".join(lines), {"effects": plain}


def show_live(
    options: Options,
    source: Session | Replica,
    say: Callable[[str], object],
    effects: Companion | None = None,
) -> None:
    """A window until it is closed or the session ends, or a page until Ctrl-C, which ends both: KeyboardInterrupt."""
    if options.view:
        from burrlab.view.live import LiveView
        from burrlab.view.scene_stereo import SIZE

        both_eyes: dict[str, Any] = {"stereo": True, "size": SIZE} if options.stereo else {}
        view = LiveView(source, effects=effects, **both_eyes)
        try:
            view.run()
        finally:
            view.close()
        if not source.wait(0.0):
            say("the window is closed, what it showed goes on; Ctrl-C ends that")
    elif options.web is not None:
        from burrlab.view.web import serve, warning

        serve(
            source, effects=effects, port=options.web, stereo=bool(options.stereo),
            on_ready=lambda address: say(warning(address)),
        )  # fmt: skip
        if not source.wait(0.0):
            raise KeyboardInterrupt
