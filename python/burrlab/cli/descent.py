"""Virtual descents on the command line: burrlab descend | sweep | materials."""

from __future__ import annotations

import argparse
import sys

import numpy as np

import burrlab
from burrlab._core import Burr
from burrlab.cli.options import (
    AddCommand,
    Options,
    add_material_options,
    add_output_options,
    chosen_material,
    count,
    positive,
    seed,
)
from burrlab.cli.output import deliver, save_figure
from burrlab.cli.volume import add_label_options, add_volume_options, chosen_specimen
from burrlab.volume.header import assumed, told_notes


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
