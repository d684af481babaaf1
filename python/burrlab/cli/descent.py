"""Virtual descents and fits on the command line: burrlab descend | sweep | materials | fit | compare | laws | design."""

import sys
from dataclasses import replace
from typing import Any, Literal

import numpy as np

import burrlab
from burrlab._core import Burr, Material
from burrlab.bone.header import assumed, told_notes
from burrlab.cli.bone import chosen_specimen, material_on
from burrlab.cli.commands import KINDS, data_kind
from burrlab.cli.options import (
    Options,
    chosen_law,
    chosen_material,
    deliver,
    on_terminal,
    plot,
    refuse_options,
    save_figure,
    say,
)
from burrlab.common.check import refuse
from burrlab.common.provenance import provenance


def _experiment(options: Options) -> tuple[Burr, Material, dict[str, Any]]:
    """Burr and material, and what else descents and sweeps share."""
    burr, material = Burr(options.radius), chosen_material(options)
    voxel = options.voxel or 0.1
    specimen = chosen_specimen(options, burr, material)
    if specimen is None and options.axis is not None:
        specimen = burrlab.half_space(burr, voxel, depth=options.stop, axis=options.axis)
    if specimen is not None:
        material = material_on(specimen.bone, material)
    return burr, material, {
        "voxel": voxel, "seed": options.seed, "specimen": specimen, "progress": on_terminal(),
        "settings": burrlab.DescentSettings(
            dt=options.dt, scheme=options.scheme, stop=options.stop, max_duration=options.max_duration
        ),
    }  # fmt: skip


def do_descend(options: Options) -> int:
    burr, material, shared = _experiment(options)
    run = burrlab.descend(burr, material, options.force, ideal=options.ideal, **shared)
    deliver(options, run.to_dict(), f"{run!r}\nseed {run.provenance['seed']}", lambda: run.plot()[0])
    return 130 if run.status == "interrupted" else 0


def do_sweep(options: Options) -> int:
    burr, material, shared = _experiment(options)
    curve = burrlab.force_sweep(
        burr, material, options.forces, repeats=options.repeats, ideal=not options.rig, store=options.store, **shared
    )  # fmt: skip
    curve.to_csv(options.out)
    notes = told_notes(curve.provenance.get("volume"))
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
    if options.plot is not None:
        axes = curve.plot()
        axes.set_title(assumed(notes), fontsize=8)
        save_figure(axes, options.plot)
    return 130 if lost else 0


def do_materials(options: Options) -> None:
    deliver(
        options,
        {
            name: {"c_e": m.c_e, "alpha": m.alpha, "shape": m.shape.name, "source": m.source}
            for name, m in burrlab.materials.items()
        },
        str(burrlab.materials),
    )


def read_data(options: Options, kind: str, **layout_options: Any) -> list[Any]:
    """The data sets in files of one kind, laid out as the options say; prints how they were read."""
    tables = {name: data_kind(name)._TABLE.named for name in KINDS if getattr(options, name, [])}
    columns = {name: [text for key, text in options.columns if key == name] for name, _ in options.columns}
    layout = {"columns": columns, "unit": options.unit}
    for what, named in layout.items():
        if isinstance(named, dict):
            for name in named:
                refuse(not any(name in known for known in tables.values()), f"--{what}: no file has a {name}")
            layout[what] = {name: text for name, text in named.items() if name in tables.get(kind, ())}
    layout_options |= layout | {name: getattr(options, name) for name in ("sep", "decimal", "encoding")}
    if kind != "trace":  # whose file has its own labels
        layout_options |= {"groups": options.groups, "specimen": options.specimen}
    data_sets = [
        data_kind(kind).from_csv(sys.stdin.buffer if file == "-" else file, **layout_options)
        for file in getattr(options, kind)
    ]
    for file, data in zip(getattr(options, kind), data_sets, strict=True):
        if "read" in data.provenance:
            say(f"{file}: {data.provenance['read']}")
    return data_sets


def do_fit(options: Options) -> None:
    engine: Literal["mean-field"] | burrlab.VoxelEngine = "mean-field"
    if options.engine == "voxel":
        store = None if options.store is None else burrlab.Store(options.store)
        engine = burrlab.VoxelEngine(
            voxel=options.voxel or 0.1, store=store, progress=on_terminal(), seed=options.seed
        )
    else:
        refuse_options(options, ("voxel", "store", "seed"), "goes with --engine voxel")
    result = burrlab.fit(
        _data(options),
        law=chosen_law(options),
        engine=engine,
        residuals=options.residuals,
        share=options.share,
        **_effects(options),
    )
    points = {} if options.test is None else {"given": options.test}
    plain, text = result.to_dict(), result.report(options.verbose)
    if options.test is not None:
        test = result.test(*options.test)
        plain["test"] = {"c_e": options.test[0], "alpha": options.test[1], "p_value": test.p_value}
        text += f"\n    - {test}"
    if len(result.data) > 1 and len(options.share) > 1:
        text += f"\n    - The {len(result.data)} files are pooled: one c_e and alpha, as of one material."
        text += " `burrlab compare` asks whether curves differ." if len(options.file) > 1 else ""
    deliver(options, plain, text)
    plot(options.plot, lambda: result.plot(alpha_lines=options.alpha_lines, log=options.log))
    plot(options.region, lambda: result.plot_region(points=points))
    plot(options.profile, result.plot_profile)


def do_compare(options: Options) -> None:
    refuse(
        (len(options.file) > 1) == (options.by is not None),
        f"needs two FILE.csv or more, or one and --by: got {len(options.file)}",
    )
    same = [file for file in options.file if options.file.count(file) > 1]
    refuse(same, f"needs another FILE.csv for each data set: got {same[0] if same else ''} twice")
    options.indentation, options.trace = [], []
    curves, fits = [x for x in _data(options) if isinstance(x, burrlab.VelocityCurve)], []
    names = ["standard input" if file == "-" else file for file in options.file]
    if options.by is not None:
        names, curves = map(list, zip(*curves[0].split(options.by).items(), strict=True))
    for curve in curves:
        sigma = curve.sigma is not None and bool(np.isfinite(curve.sigma[curve.ok]).all())
        fits.append(
            burrlab.fit(
                curve,
                law=chosen_law(options),
                residuals="relative" if options.residuals == "sigma" and not sigma else options.residuals,
                **_effects(options),
            )
        )
    result = burrlab.compare(*fits, margin=options.margin, names=names, shared=options.shared)
    deliver(options, result.to_dict(), result.report(), result.plot)


def do_laws(options: Options) -> None:
    named = {} if options.laws is None else {"laws": options.laws}
    result = burrlab.compare_laws(
        _data(options), level=options.level, residuals=options.residuals, uncertain=options.uncertain,
        progress=on_terminal(), **named,
    )  # fmt: skip
    deliver(options, result.to_dict(), result.report(), lambda: result.plot()[0])


def do_design(options: Options) -> None:
    known = burrlab.Fit.from_json(options.fit)
    if options.compare is not None:
        return _compare_power(options, known)
    refuse_options(options, ("between", "sheet"), "goes with --compare")
    radii = options.radii or known.radius
    refuse(options.forces and radii is None, "--radii must be given: the data are of several radii")
    result = burrlab.design(
        known, options.forces, radii or [], options.repeats, static=options.static,
        static_radius=options.static_radius, scatter=options.scatter, static_scatter=options.static_scatter,
        truths=options.truths, seed=options.seed, progress=on_terminal(),
        against=None if options.against is None else burrlab.Fit.from_json(options.against),
    )  # fmt: skip
    deliver(options, result.to_dict(), f"{result!r}\nseed {result.seed}", result.plot)


def _compare_power(options: Options, known: burrlab.Fit) -> None:
    study = burrlab.compare_power(
        known, options.compare, specimens=options.specimens, runs=options.runs, between=options.between,
        within=options.scatter, forces=options.forces or None, aim=options.power, progress=on_terminal(),
    )  # fmt: skip
    if options.sheet is not None:
        size = study.smallest()
        if size is None:
            raise ValueError("--sheet: no comparison of these sizes reaches the power; try more --specimens")
        burrlab.run_sheet(
            study.forces, specimens=size[0], runs=size[1], radius=known.radius, seed=options.seed
        ).to_csv(options.sheet)
    deliver(options, study.to_dict(), repr(study), study.plot)


def _data(options: Options) -> list[burrlab.VelocityCurve | burrlab.Indentation | burrlab.DepthTrace]:
    """The data sets of a fit, each with its own radius or --radius."""
    refuse(not options.file and not options.trace, "a fit needs velocities: give a FILE.csv or --trace")
    data_sets: list[burrlab.VelocityCurve | burrlab.Indentation | burrlab.DepthTrace] = []
    for file, curve in zip(options.file, read_data(options, "file"), strict=True):
        radius = curve.radius or options.radius
        refuse(radius is None, f"--radius must be given: {file} does not say it")
        if options.radius not in (None, radius):
            raise ValueError(f"--radius is {options.radius:g} mm, but {file} was taken with {radius:g} mm")
        data_sets.append(replace(curve, radius=radius))
    for kind in ("indentation", "trace"):
        data_sets += read_data(options, kind, radius=options.radius)
    return data_sets


def _effects(options: Options) -> dict[str, Any]:
    """What `burrlab.fit` is told of groups, offsets and known values."""
    return {
        "groups": () if options.groups == {} else None,
        "uncertain": options.uncertain,
        "estimate": options.estimate,
        "known": options.known,
    }


def do_version(options: Options) -> None:
    deliver(options, {"version": burrlab.__version__, **provenance()}, f"burrlab {burrlab.__version__}")
