"""The fit of c_e and alpha on the command line: burrlab fit."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace

import burrlab
from burrlab._core import Shape
from burrlab.cli.options import AddCommand, Options, add_output_options, positive, seed, shape
from burrlab.cli.output import deliver, save_figure


def add_fit_command(command: AddCommand) -> None:
    """Adds `fit` to the parser of `burrlab`."""
    fit = command("fit", _fit, "Fit c_e and alpha, and say what the data determine.")
    fit.add_argument("file", metavar="FILE.csv", nargs="*", help="velocity-force curves")
    fit.add_argument("--radius", type=positive, help="burr radius R of files that do not say it [mm]")
    fit.add_argument(
        "--indentation",
        metavar="FILE.csv",
        action="append",
        default=[],
        help="static indentation, repeatable",
    )
    fit.add_argument(
        "--trace", metavar="FILE.csv", action="append", default=[], help="depth-time record, repeatable"
    )
    fit.add_argument(
        "--shape", type=shape, default=Shape("parabolic"), help="erosion shape f, default parabolic"
    )
    fit.add_argument("--engine", choices=["mean-field", "voxel"], default="mean-field")
    fit.add_argument("--residuals", choices=["relative", "absolute", "sigma"], default="relative")
    fit.add_argument("--voxel", type=positive, default=0.1, help="voxel engine: spacing [mm]")
    fit.add_argument("--seed", type=seed, default=0)
    fit.add_argument(
        "--alpha-lines", type=positive, metavar="D", help="also draw alpha +- D [1/ms], as the paper does"
    )
    fit.add_argument("--log", action="store_true", help="logarithmic axes in the figure")
    fit.add_argument("--region", metavar="FILE", help="write a figure of the joint region of c_e and alpha")
    fit.add_argument("--profile", metavar="FILE", help="write a figure of c_e's profile likelihood")
    fit.add_argument("--test", type=_pair, metavar="C_E,ALPHA", help="are these in the joint region?")
    fit.add_argument("--store", metavar="FILE", help="voxel engine: keeps descents, the same command goes on")
    add_output_options(fit)


def _pair(text: str) -> tuple[float, float]:
    values = [positive(part) for part in text.split(",")]
    if len(values) != 2:
        raise argparse.ArgumentTypeError(f"must be C_E,ALPHA, got '{text}'")
    return values[0], values[1]


def _fit(options: Options) -> int:
    if options.store is not None and options.engine != "voxel":
        raise ValueError("--store goes with --engine voxel")
    result = burrlab.fit(
        _data(options), shape=options.shape, engine=options.engine, residuals=options.residuals,
        seed=options.seed, voxel=options.voxel, store=_store(options), progress=_bar(options),
    )  # fmt: skip
    given = {} if options.test is None else {"given": options.test}
    if options.plot is not None:
        save_figure(result.plot(alpha_lines=options.alpha_lines, log=options.log), options.plot)
    if options.region is not None:
        save_figure(result.plot_region(points=given), options.region)
    if options.profile is not None:
        save_figure(result.plot_profile(), options.profile)
    plain, text = result.to_dict(), result.report()
    if options.test is not None:
        test = result.test(*options.test)
        plain["test"] = {"c_e": options.test[0], "alpha": options.test[1], "p_value": test.p_value}
        text += f"\n    - {test}"
    deliver(options, plain, text)
    return 0


def _data(options: Options) -> list[burrlab.VelocityCurve | burrlab.Indentation | burrlab.DepthTrace]:
    """The data sets of a fit, each with its radius: its own or --radius."""
    if not options.file and not options.trace:
        raise ValueError("a fit needs velocities: give a FILE.csv or --trace")
    found: list[burrlab.VelocityCurve | burrlab.Indentation | burrlab.DepthTrace] = []
    for file in options.file:
        curve = burrlab.VelocityCurve.from_csv(file)
        if curve.radius is None and options.radius is None:
            raise ValueError(f"--radius must be given: {file} does not say it")
        if None not in (curve.radius, options.radius) and curve.radius != options.radius:
            raise ValueError(
                f"--radius is {options.radius:g} mm, but {file} was taken with {curve.radius:g} mm"
            )
        found.append(curve if curve.radius is not None else replace(curve, radius=options.radius))
    found += [burrlab.Indentation.from_csv(file, radius=options.radius) for file in options.indentation]
    found += [burrlab.DepthTrace.from_csv(file, radius=options.radius) for file in options.trace]
    return found


def _store(options: Options) -> burrlab.Store | None:
    return None if options.store is None else burrlab.Store(options.store)


def _bar(options: Options) -> Callable[[int, int], object] | None:
    """A progress bar for the voxel engine, on a terminal."""
    if options.engine != "voxel" or not sys.stderr.isatty():
        return None
    from tqdm import tqdm

    bar = tqdm(desc="descents", leave=False)

    def show(done: int, total: int) -> None:
        bar.total = total
        bar.update(done - bar.n)

    return show
