"""Virtual descents on the command line: burrlab descend | sweep | materials.

The fit of c_e and alpha on the command line: burrlab fit.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

import burrlab
from burrlab._core import Burr, Shape
from burrlab.bone.header import assumed, told_notes
from burrlab.cli.options import (
    AddCommand,
    Options,
    add_label_options,
    add_material_options,
    add_output_options,
    add_volume_options,
    chosen_material,
    chosen_specimen,
    count,
    deliver,
    positive,
    save_figure,
    seed,
    shape,
)


def add_descent_commands(command: AddCommand) -> None:
    """Adds the commands on descents to the parser of `burrlab`."""
    descent = command(
        "descend", _descend, "Sink a burr at constant force and measure its penetration velocity."
    )
    descent.add_argument("--force", type=positive, required=True, help="set-point [N]")
    descent.add_argument(
        "--ideal", action="store_true", help="hold the force exactly, without rig and controller"
    )
    _experiment_options(descent)
    add_output_options(descent)

    sweep = command("sweep", _sweep, "Penetration velocity against force, written as CSV.")
    sweep.add_argument(
        "--forces", type=_forces, required=True, metavar="FIRST:LAST:COUNT", help="[N]; or F,F,..."
    )
    sweep.add_argument("--repeats", type=count, default=1, help="descents at each force, default 1")
    sweep.add_argument("--out", required=True, metavar="FILE.csv")
    sweep.add_argument(
        "--rig", action="store_true", help="through controller and virtual rig; else the force is exact"
    )
    sweep.add_argument(
        "--store", metavar="FILE", help="keep every descent as it ends (JSON lines), and take from there what an earlier sweep of "
        "the same parameters and seed has done: an interrupted one goes on; needs --seed",
    )  # fmt: skip
    _experiment_options(sweep)
    add_output_options(sweep)
    add_output_options(
        command("materials", _materials, "The paper's materials and their source."), plot=False
    )


def _forces(text: str) -> list[float]:
    if ":" not in text:
        return [positive(part) for part in text.split(",")]
    parts = text.split(":")
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"must be FIRST:LAST:COUNT or F,F,..., got '{text}'")
    return [float(f) for f in np.linspace(positive(parts[0]), positive(parts[1]), count(parts[2]))]


def _experiment_options(parser: argparse.ArgumentParser) -> None:
    add_material_options(parser)
    parser.add_argument("--voxel", type=positive, help="voxel spacing [mm], default 0.1, or a volume's own")
    parser.add_argument("--dt", type=positive, default=1.0, help="tick [ms], default 1")
    parser.add_argument("--seed", type=seed, help="default: drawn and recorded")
    parser.add_argument("--scheme", choices=["layer", "cell"], default="layer", help="default: layer")
    parser.add_argument("--stop", type=positive, help="immersion at which a run ends [mm], default R/3")
    parser.add_argument(
        "--max-duration", type=positive, default=120.0, help="[s] of the experiment, default 120"
    )
    add_volume_options(parser)
    add_label_options(parser)


def _specimen(options: Options, burr: Burr) -> burrlab.Specimen | None:
    specimen = chosen_specimen(options, burr, chosen_material(options))
    if specimen is not None or options.axis is None:
        return specimen
    return burrlab.half_space(burr, options.voxel or 0.1, depth=options.stop, axis=options.axis)


def _descend(options: Options) -> int:
    burr, material = Burr(options.radius), chosen_material(options)
    specimen = _specimen(options, burr)
    from tqdm import tqdm

    with tqdm(total=100, desc="descent", unit="%", disable=not sys.stderr.isatty(), leave=False) as bar:
        run = burrlab.descend(
            burr, material, options.force, voxel=options.voxel or 0.1, dt=options.dt, seed=options.seed,
            scheme=options.scheme, ideal=options.ideal, specimen=specimen, stop=options.stop,
            max_duration=options.max_duration, progress=lambda done: bar.update(int(100 * done) - bar.n),
        )  # fmt: skip
    if options.plot is not None:
        save_figure(run.plot()[0], options.plot)
    deliver(options, run.to_dict(), f"{run!r}\nseed {run.provenance['seed']}")
    return 130 if run.status == "interrupted" else 0


def _sweep(options: Options) -> int:
    burr, material = Burr(options.radius), chosen_material(options)
    curve = burrlab.force_sweep(
        burr, material, options.forces, repeats=options.repeats, voxel=options.voxel or 0.1, dt=options.dt,
        seed=options.seed, scheme=options.scheme, rig=options.rig, specimen=_specimen(options, burr),
        stop=options.stop, max_duration=options.max_duration, store=options.store, progress=sys.stderr.isatty(),
    )  # fmt: skip
    curve.to_csv(options.out)
    notes = told_notes(curve.provenance.get("volume"))
    if options.plot is not None:
        axes = curve.plot()
        axes.set_title(assumed(notes), fontsize=8)
        save_figure(axes, options.plot)
    ok = int(curve.ok.sum())
    result = {
        "file": str(options.out),
        "n_points": len(curve),
        "n_ok": ok,
        "seed": curve.provenance["seed"],
        "version": burrlab.__version__,
        "warnings": curve.provenance["warnings"],
        "notes": list(notes),
        "status": list(curve.status or ()),
    }
    lost = (curve.status or ()).count("interrupted")
    text = f"{len(curve)} descents, {ok} with a velocity, written to {options.out}; seed {result['seed']}"
    text += "".join(f"; {name}" for name in curve.provenance["warnings"])
    if lost:
        text += f"; {lost} interrupted"
        text += "" if options.store is None else f", the same command goes on from {options.store}"
    deliver(options, result, text)
    return 130 if lost else 0


def _materials(options: Options) -> int:
    table = {
        name: {"c_e": m.c_e, "alpha": m.alpha, "shape": m.shape.name, "source": m.source}
        for name, m in burrlab.materials.items()
    }
    lines = [f"{'name':<10} {'c_e [N/mm^2]':>12} {'alpha [1/ms]':>12}  shape      source"]
    lines += [
        f"{n:<10} {m['c_e']:>12} {m['alpha']:>12}  {m['shape']:<10} {m['source']}" for n, m in table.items()
    ]
    deliver(options, table, "\n".join(lines))
    return 0


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
        _data(options),
        shape=options.shape,
        engine=_engine(options),
        residuals=options.residuals,
        seed=options.seed,
    )
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


def _engine(options: Options) -> Literal["mean-field"] | burrlab.VoxelEngine:
    if options.engine == "mean-field":
        return "mean-field"
    store = None if options.store is None else burrlab.Store(options.store)
    return burrlab.VoxelEngine(voxel=options.voxel, store=store, progress=_bar())


def _bar() -> Callable[[int, int], object] | None:
    """A progress bar on a terminal."""
    if not sys.stderr.isatty():
        return None
    from tqdm import tqdm

    bar = tqdm(desc="descents", leave=False)

    def show(done: int, total: int) -> None:
        bar.total = total
        bar.update(done - bar.n)

    return show
