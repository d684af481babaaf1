"""Virtual descents and fits on the command line: burrlab descend | sweep | materials | fit | compare | design."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from typing import Any, Literal

import numpy as np

import burrlab
from burrlab._core import Burr
from burrlab.bone.header import assumed, told_notes
from burrlab.cli.options import (
    JSON,
    LABELS,
    MATERIAL,
    OUTPUT,
    VOLUME,
    Command,
    Group,
    Options,
    chosen_material,
    chosen_specimen,
    count,
    deliver,
    flag,
    on_terminal,
    option,
    parsed_by,
    plot,
    positive,
    refuse_options,
    save_figure,
    seed,
    shape,
)
from burrlab.common.check import refuse


@parsed_by
def _numbers(text: str) -> list[float]:
    if ":" not in text:
        return [positive(part) for part in text.split(",")]
    parts = text.split(":")
    refuse(len(parts) != 3, f"must be FIRST:LAST:COUNT or F,F,..., got '{text}'")
    return [float(f) for f in np.linspace(positive(parts[0]), positive(parts[1]), count(parts[2]))]


def _specimen(options: Options, burr: Burr) -> burrlab.Specimen | None:
    specimen = chosen_specimen(options, burr, chosen_material(options))
    if specimen is not None or options.axis is None:
        return specimen
    return burrlab.half_space(burr, options.voxel or 0.1, depth=options.stop, axis=options.axis)


def _descend(options: Options) -> int:
    burr, material = Burr(options.radius), chosen_material(options)
    specimen = _specimen(options, burr)
    run = burrlab.descend(
        burr, material, options.force, voxel=options.voxel or 0.1, dt=options.dt, seed=options.seed,
        scheme=options.scheme, ideal=options.ideal, specimen=specimen, stop=options.stop,
        max_duration=options.max_duration, progress=on_terminal(),
    )  # fmt: skip
    plot(options.plot, lambda: run.plot()[0])
    deliver(options, run.to_dict(), f"{run!r}\nseed {run.provenance['seed']}")
    return 130 if run.status == "interrupted" else 0


def _sweep(options: Options) -> int:
    burr, material = Burr(options.radius), chosen_material(options)
    curve = burrlab.force_sweep(
        burr, material, options.forces, repeats=options.repeats, voxel=options.voxel or 0.1, dt=options.dt,
        seed=options.seed, scheme=options.scheme, ideal=not options.rig, specimen=_specimen(options, burr),
        stop=options.stop, max_duration=options.max_duration, store=options.store, progress=on_terminal(),
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
    deliver(options, table, str(burrlab.materials))
    return 0


_KINDS: dict[str, Any] = {
    "file": burrlab.VelocityCurve, "indentation": burrlab.Indentation, "trace": burrlab.DepthTrace,
}  # fmt: skip


def _named(text: str) -> list[tuple[str, str]]:
    """NAME=TEXT,NAME=TEXT, in which a text may hold commas, or stand in quotation marks."""
    names = dict.fromkeys(name for kind in _KINDS.values() for name in kind._TABLE.named)
    parts = re.split(rf"(?:^|,)({'|'.join(names)})=", text)
    refuse(parts[0] or len(parts) < 2, f"must begin with NAME=, a NAME of {', '.join(names)}, got '{text}'")
    texts = (re.sub(r"""^(["'])(.*)\1$""", r"\2", part) for part in parts[2::2])
    return list(zip(parts[1::2], texts, strict=True))


def read_data(options: Options, kind: str, **given: Any) -> list[Any]:
    """The data sets in files of one kind, laid out as the options say; prints how they were read."""
    tables = {name: made._TABLE.named for name, made in _KINDS.items() if getattr(options, name, [])}
    told = options.columns
    layout = {
        "columns": {name: [text for key, text in told if key == name] for name, _ in told},
        "unit": options.unit,
    }
    for what, named in layout.items():
        if isinstance(named, dict):
            for name in named:
                refuse(not any(name in known for known in tables.values()), f"--{what}: no file has a {name}")
            layout[what] = {name: text for name, text in named.items() if name in tables.get(kind, ())}
    given |= layout | {name: getattr(options, name) for name in ("sep", "decimal", "encoding")}
    found = [_KINDS[kind].from_csv(file, **given) for file in getattr(options, kind)]
    for file, data in zip(getattr(options, kind), found, strict=True):
        if "read" in data.provenance:
            print(f"burrlab: {file}: {data.provenance['read']}", file=sys.stderr)
    return found


@parsed_by
def _pair(text: str) -> tuple[float, float]:
    values = [positive(part) for part in text.split(",")]
    refuse(len(values) != 2, f"must be C_E,ALPHA, got '{text}'")
    return values[0], values[1]


def _fit(options: Options) -> int:
    if options.engine != "voxel":
        refuse_options(options, ("store",), "goes with --engine voxel")
    result = burrlab.fit(
        _data(options),
        shape=options.shape,
        engine=_engine(options),
        residuals=options.residuals,
        seed=options.seed,
    )
    given = {} if options.test is None else {"given": options.test}
    plot(options.plot, lambda: result.plot(alpha_lines=options.alpha_lines, log=options.log))
    plot(options.region, lambda: result.plot_region(points=given))
    plot(options.profile, result.plot_profile)
    plain, text = result.to_dict(), result.report(options.verbose)
    if options.test is not None:
        test = result.test(*options.test)
        plain["test"] = {"c_e": options.test[0], "alpha": options.test[1], "p_value": test.p_value}
        text += f"\n    - {test}"
    if len(result.data) > 1:
        text += f"\n    - The {len(result.data)} files are pooled: one c_e and alpha, as of one material."
        text += " `burrlab compare` asks whether curves differ." if len(options.file) > 1 else ""
    deliver(options, plain, text)
    return 0


def _compare(options: Options) -> int:
    refuse(len(options.file) < 2, f"needs two FILE.csv or more: got {len(options.file)}")
    options.indentation, options.trace = [], []
    fits: list[burrlab.Fit] = []
    for curve in _data(options):
        assert isinstance(curve, burrlab.VelocityCurve)
        sigma = curve.sigma is not None and bool(np.isfinite(curve.sigma[curve.ok]).all())
        fits.append(
            burrlab.fit(
                curve,
                shape=options.shape,
                residuals="relative" if options.residuals == "sigma" and not sigma else options.residuals,
            )
        )
    result = burrlab.compare(*fits, margin=options.margin, names=options.file)
    plot(options.plot, result.plot)
    deliver(options, result.to_dict(), result.report())
    return 0


def _design(options: Options) -> int:
    known = burrlab.Fit.from_json(options.fit)
    radii = options.radii or known.radius
    refuse(options.forces and radii is None, "--radii must be given: the data are of several radii")
    result = burrlab.design(
        known, options.forces, radii or [], options.repeats, static=options.static,
        static_radius=options.static_radius, scatter=options.scatter, static_scatter=options.static_scatter,
        truths=options.truths, seed=options.seed, progress=on_terminal(),
    )  # fmt: skip
    plot(options.plot, result.plot)
    deliver(options, result.to_dict(), f"{result!r}\nseed {result.seed}")
    return 0


def _data(options: Options) -> list[burrlab.VelocityCurve | burrlab.Indentation | burrlab.DepthTrace]:
    """The data sets of a fit, each with its own radius or --radius."""
    refuse(not options.file and not options.trace, "a fit needs velocities: give a FILE.csv or --trace")
    found: list[burrlab.VelocityCurve | burrlab.Indentation | burrlab.DepthTrace] = []
    for file, curve in zip(options.file, read_data(options, "file"), strict=True):
        radius = curve.radius or options.radius
        refuse(radius is None, f"--radius must be given: {file} does not say it")
        if options.radius not in (None, radius):
            raise ValueError(f"--radius is {options.radius:g} mm, but {file} was taken with {radius:g} mm")
        found.append(replace(curve, radius=radius))
    for kind in ("indentation", "trace"):
        found += read_data(options, kind, radius=options.radius)
    return found


def _engine(options: Options) -> Literal["mean-field"] | burrlab.VoxelEngine:
    if options.engine == "mean-field":
        return "mean-field"
    store = None if options.store is None else burrlab.Store(options.store)
    return burrlab.VoxelEngine(voxel=options.voxel, store=store, progress=on_terminal())


#: Options for files of other programs.
LAYOUT = Group("files of another program, all of the same layout", (
    option(
        "--columns", "headings of force, velocity and so on; repeatable, also for one NAME with repeats in several columns",
        type=parsed_by(_named), action="extend", default=[], metavar="NAME=HEADING,...",
    ),
    option(
        "--unit", "of all columns that can have it, such as um/s, or of single ones",
        type=parsed_by(lambda text: dict(_named(text)) if "=" in text else text), metavar="UNIT|NAME=UNIT,...",
    ),
    option("--sep", "separator, or tab; default: the one between the headings"),
    option("--decimal", "mark of decimals, default a point", choices=[".", ","], metavar="MARK"),
    option("--encoding", "such as cp1252, latin-1 or utf-16; default UTF-8"),
))  # fmt: skip
_EXPERIMENT = (
    *MATERIAL,
    option("--voxel", "voxel spacing [mm], default 0.1, or a volume's own", type=positive),
    option("--dt", "tick [ms], default 1", type=positive, default=1.0),
    option("--seed", "default: drawn and recorded", type=seed),
    option("--scheme", "default: layer", choices=["layer", "cell"], default="layer"),
    option("--stop", "immersion at which a run ends [mm], default R/3", type=positive),
    option("--max-duration", "[s] of the experiment, default 120", type=positive, default=120.0),
    VOLUME,
    LABELS,
    *OUTPUT,
)
_RADIUS = option("--radius", "burr radius R of files that do not say it [mm]", type=positive)
_SHAPE = option(
    "--shape", "erosion shape f, or a FILE.csv of x and f; default parabolic", type=shape, default="parabolic"
)
_RESIDUALS: dict[str, Any] = {
    "choices": ["relative", "absolute", "sigma", "student"], "default": "relative",
}  # fmt: skip
DESCENT_COMMANDS = (
    Command("descend", _descend, "Sink a burr at constant force and measure its penetration velocity.", (
        option("--force", "set-point [N]", type=positive, required=True),
        flag("--ideal", "hold the force exactly, without rig and controller"),
        *_EXPERIMENT,
    )),
    Command("sweep", _sweep, "Penetration velocity against force, written as CSV.", (
        option("--forces", "[N]; or F,F,...", type=_numbers, required=True, metavar="FIRST:LAST:COUNT"),
        option("--repeats", "descents at each force, default 1", type=count, default=1),
        option("--out", required=True, metavar="FILE.csv"),
        flag("--rig", "through controller and virtual rig; else the force is exact"),
        option(
            "--store",
            "keep every descent as it ends (JSON lines), and take from there what an earlier sweep of "
            "the same parameters and seed has done: an interrupted one goes on; needs --seed", metavar="FILE",
        ),
        *_EXPERIMENT,
    )),
    Command("materials", _materials, "The paper's materials and their source.", (JSON,)),
    Command("fit", _fit, "Fit c_e and alpha, and say what the data determine.", (
        option("file", "velocity-force curves", metavar="FILE.csv", nargs="*"),
        _RADIUS,
        option(
            "--indentation", "static indentation, repeatable", metavar="FILE.csv", action="append", default=[]
        ),
        option("--trace", "depth-time record, repeatable", metavar="FILE.csv", action="append", default=[]),
        _SHAPE,
        option("--engine", choices=["mean-field", "voxel"], default="mean-field"),
        option("--residuals", **_RESIDUALS),
        option("--voxel", "voxel engine: spacing [mm]", type=positive, default=0.1),
        option("--seed", "default: drawn and recorded", type=seed),
        option("--alpha-lines", "also draw alpha +- D [1/ms], as the paper does", type=positive, metavar="D"),
        flag("--log", "logarithmic axes in the figure"),
        flag("--verbose", "also print the table of searches, with nlopt's return codes"),
        option("--region", "write a figure of the joint region of c_e and alpha", metavar="FILE"),
        option("--profile", "write a figure of c_e's profile likelihood", metavar="FILE"),
        option("--test", "are these in the joint region?", type=_pair, metavar="C_E,ALPHA"),
        option("--store", "voxel engine: keeps descents, the same command goes on", metavar="FILE"),
        LAYOUT,
        *OUTPUT,
    )),
    Command("compare", _compare, "Are velocity-force curves of one material? Each file is fitted by itself.", (
        option("file", "velocity-force curves, one a data set", metavar="FILE.csv", nargs="+"),
        option(
            "--margin", "difference of velocity that counts as equivalent, set beforehand: 0.2 is 20 %%",
            type=positive,
        ),
        _RADIUS,
        _SHAPE,
        option("--residuals", "sigma: of files that have one; the others stay relative", **_RESIDUALS),
        LAYOUT,
        *OUTPUT,
    )),
    Command("design", _design, "Which measurement next? Rank candidates by how they shrink the joint region.", (
        option("fit", "of the data so far, as `burrlab fit --json` writes it", metavar="FIT.json"),
        option(
            "--forces", "of new velocities [N]; or F,F,...", type=_numbers, default=[],
            metavar="FIRST:LAST:COUNT",
        ),
        option("--radii", "of new velocities [mm], default that of the data", type=_numbers, metavar="R,R,..."),
        option("--static", "depths of new static pairs [mm]", type=_numbers, metavar="H,H,..."),
        option("--static-radius", "burr radius of static pairs [mm], default that of the data", type=positive),
        option("--repeats", "of each candidate, default 3", type=count, default=3),
        option("--scatter", "of new velocities: 0.08 is 8 %%; default that of the data", type=positive),
        option("--static-scatter", "of new static forces; default that of the data, or 0.1", type=positive),
        option("--truths", "values of c_e and alpha that the mean is taken over, default 100", type=count, default=100),
        option("--seed", "default: drawn and recorded", type=seed),
        *OUTPUT,
    )),
)  # fmt: skip
