"""Psychophysical experiments on the command line: burrlab experiment new | power | run | resume | analyse."""

import contextlib
import functools
import logging
import os
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from burrlab.cli.options import (
    Options,
    deliver,
    ended_by_signals,
    refuse_options,
    save_figure,
    say,
    show_line,
    working,
)
from burrlab.common.check import refuse
from burrlab.common.figures import Axes
from burrlab.common.files import write_text
from burrlab.common.progress import LOG
from burrlab.psychophysics.analysis import Analysis, analyse, write_rows
from burrlab.psychophysics.answers import read_folder, trial_rows
from burrlab.psychophysics.designs import MODES
from burrlab.psychophysics.observer import CUES_OF, SimulatedSubject
from burrlab.psychophysics.protocol import Protocol, template
from burrlab.psychophysics.psychometric import PsychometricFit
from burrlab.psychophysics.rehearsal import SimulatedSeat
from burrlab.psychophysics.run import DeviceLost, Seat, Sitting, TerminalSeat
from burrlab.psychophysics.task_results import ScoredTask, ThresholdTask
from burrlab.psychophysics.weber import COMPLIANCE_WITHOUT_SURFACE


def do_new(options: Options) -> None:
    path = Path(options.config)
    refuse(os.path.lexists(path), f"{path} exists and is not replaced", FileExistsError)
    write_text(path, template())
    print(
        f"{path} is written: a protocol to be changed. Its designs can show what follows; "
        f"burrlab experiment power {path} says it again.\n"
        f"A rehearsal that needs nobody: burrlab experiment run {path} --simulated --all --fast\n"
    )
    do_power(options)


def do_power(options: Options) -> None:
    protocol = Protocol.read(options.config)
    for name, design in protocol.tasks.items():
        with working(f"task {name}: simulating"):
            power = design.power(len(protocol.subjects))
        print(f"task {name}, {protocol.minutes(name):.0f} min of intervals and breaks\n{power}\n", flush=True)
    total = sum(map(protocol.minutes, protocol.tasks)) + (len(protocol.units) - 1) * protocol.rest / 60.0
    print(f"all tasks: {total:.0f} min a subject, and the time of answers")


def do_run(options: Options) -> int:
    sittings = _sittings(options)
    for sitting in sittings:
        refuse(
            sitting.begun,
            f"subject {sitting.subject} has begun task {''.join(sitting.begun[:1])}: "
            f"{_command('resume', options, sitting.subject)} goes on",
        )
    return _sit(options, sittings)


def do_resume(options: Options) -> int:
    sittings = _sittings(options)
    first = sittings[0].subject
    refuse(
        not any(sitting.begun for sitting in sittings),
        f"subject {first} has begun no task: {_command('run', options, first)} begins",
    )
    return _sit(options, sittings)


def do_analyse(options: Options) -> None:
    figures = None if options.figures is None else Path(options.figures)
    refuse(figures and figures.exists() and not figures.is_dir(), f"--plot: {figures} is no folder")
    for name in ("json", "tsv", "trials"):
        _check_apart(name, getattr(options, name), options.config)
    with working("analysis"):
        analysis = analyse(
            options.config, incomplete=options.incomplete,
            progress=lambda task, subject: show_line(f"task {task}, subject {subject}"),
        )  # fmt: skip
        if options.tsv is not None:
            analysis.to_tsv(options.tsv)
        if options.trials is not None:
            folder = options.config if Path(options.config).is_dir() else Protocol.read(options.config).folder
            write_rows(options.trials, trial_rows(read_folder(folder)))
        drawn = "" if figures is None else _draw(analysis, figures)
    report = analysis.report(width=shutil.get_terminal_size().columns if sys.stdout.isatty() else None)
    deliver(options, analysis.to_dict(), report + drawn)


def _check_apart(option: str, path: str | None, config: str) -> None:
    """ValueError if an output would go into a file of the experiment itself."""
    if path is None or path == "-":
        return
    folder = (Path(config) if Path(config).is_dir() else Protocol.read(config).folder).resolve()
    file = Path(path).resolve()
    within = file.relative_to(folder).parts[0] if folder in file.parents else ""
    described = ("participants.tsv", "participants.json", "dataset_description.json", "README", "sourcedata")
    refuse(
        file.suffix == ".toml" or within.startswith("sub-") or within in described,
        f"--{option}: {path} is of the experiment and is not written to",
    )


def _draw(analysis: Analysis, folder: Path) -> str:
    """Draws all figures into files; returns where they are."""
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        f"task-{task.name}_{name}": draw for task in analysis.tasks for name, draw in _figures(task).items()
    }
    for function in analysis.sensitivity_functions():
        figures["sensitivity-" + "-".join(re.findall(r"\w+", function.name))] = function.plot
    for name, draw in figures.items():
        show_line(f"figure {name}")
        axes = draw()
        save_figure(axes, str(folder / f"{name}.png"))
        plt.close(axes.get_figure(root=True))
    return f"\n\n{len(figures)} figures are in {folder}: task-NAME_FIGURE.png"


def _figures(task: ScoredTask | ThresholdTask) -> dict[str, Callable[[], Axes]]:
    """The figures that a task's data allow."""
    if isinstance(task, ThresholdTask):
        drawn: dict[str, Callable[[], Axes]] = {
            f"psychometric_sub-{row.subject}": functools.partial(task.plot_psychometric, subject=row.subject)
            for row in task.subjects
            if isinstance(row.estimate, PsychometricFit)
        }
        with_thresholds = any(row.threshold is not None for row in task.subjects)
        return {**drawn, "thresholds": task.plot_thresholds} if with_thresholds else drawn
    drawn = {"intervals": task.plot_intervals, "d_prime": task.plot_d_prime} if task.subjects else {}
    return drawn if task.trials is None else {"scores": task.plot_scores, **drawn}


def _sittings(options: Options) -> list[Sitting]:
    """The sittings that the options ask for, after all possible checks."""
    protocol = Protocol.read(options.config)
    _check_apart("experimenter", options.experimenter, options.config)
    refuse_options(
        options, ("all", "weber", "decision", "fast"), "goes with --simulated", not options.simulated
    )
    refuse(
        (options.subject is None) != options.all,
        "--subject LABEL or --simulated --all must say who takes part",
    )
    refuse(
        options.simulated and options.device is not None,
        "--device does not go with --simulated: a simulated subject has the simulated hand",
    )
    # the side-car's entry on simulated subjects; the cues that a subject uses depend on the mode
    simulated: dict[str, Any] = {
        "rendered": "each material once a task" if options.fast else "each interval",
        **{mode: _simulated_subject(options, mode).to_dict() for mode in MODES},
    }
    if any(design.boundary is not None for design in protocol.tasks.values()):
        simulated["boundary"] = _simulated_subject(options, "drilling", boundary=True).to_dict()
    return [
        Sitting(
            protocol, subject, tasks=None if options.task is None else [options.task],
            device="hand" if options.simulated else options.device, once=options.fast,
            simulated=simulated if options.simulated else None, view=options.experimenter,
            again=_command("resume", options, subject),
        )
        for subject in (protocol.subjects if options.all else [options.subject])
    ]  # fmt: skip


def _sit(options: Options, sittings: Sequence[Sitting]) -> int:
    at = sittings[0]
    try:
        with ended_by_signals(), contextlib.ExitStack() as stack:
            if not options.simulated:
                return _sit_down(stack, at)
            for at in sittings:
                with working(f"simulated subject {at.subject}"):
                    answered = at.run(lambda task, sitting=at: _simulated_seat(options, sitting, task))  # type: ignore[misc]
                print(f"simulated subject {at.subject}: {answered} trials answered")
    except (DeviceLost, KeyboardInterrupt) as error:
        lost = isinstance(error, DeviceLost)
        if options.simulated:
            reason = f"{error};" if lost else "interrupted; every answer is kept,"
            say(f"{reason} {_command('resume', options, at.subject)} goes on")
        return 1 if lost else 130
    return 0


def _sit_down(stack: contextlib.ExitStack, sitting: Sitting) -> int:
    seat = stack.enter_context(TerminalSeat())
    stack.callback(LOG.setLevel, LOG.level)
    LOG.setLevel(logging.ERROR)  # the log would go to the subject's screen
    try:
        answered = sitting.run(lambda task: seat)
    except (DeviceLost, KeyboardInterrupt):  # the experimenter sees the reason and the next step
        with contextlib.suppress(KeyboardInterrupt):  # the terminal itself may be lost
            seat.close("Please wait. Every answer is kept.")
        raise
    if answered:
        seat.close("That was all. Thank you.")
    else:
        print(f"subject {sitting.subject} has answered everything")
    return 0


def _simulated_subject(options: Options, mode: Any, *, boundary: bool = False) -> SimulatedSubject:
    """A subject who feels stiffness in probing; in drilling sinking speed, or its change with a boundary.

    For speeds and their changes no fraction is published.
    """
    return SimulatedSubject(
        options.weber or COMPLIANCE_WITHOUT_SURFACE,
        [CUES_OF[mode][boundary]],
        options.decision or "differencing",
    )


def _simulated_seat(options: Options, sitting: Sitting, task: str) -> Seat:
    protocol = sitting.protocol
    design = protocol.tasks[task]
    return SimulatedSeat(
        _simulated_subject(options, design.mode, boundary=design.boundary is not None), design, burr=protocol.burr, bone=protocol.bone,
        seed=protocol.seed, name=f"{sitting.subject} {task}",
        on_progress=lambda text: show_line(
            f"simulated subject {sitting.subject}, task {task}: {text.lower()}"),
    )  # fmt: skip


def _command(action: str, options: Options, subject: str) -> str:
    """The command line for an action."""
    who = "--all" if options.all else f"--subject {subject}"
    given = {name: getattr(options, name) for name in ("task", "device", "experimenter", "weber", "decision")}
    values = [f"--{name} {value}" for name, value in given.items() if value is not None]
    flags = [f"--{name}" for name in ("simulated", "fast") if getattr(options, name)]
    return " ".join(["burrlab experiment", action, str(options.config), who, *values, *flags])
