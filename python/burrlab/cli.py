"""The command line, thin over the API: `burrlab COMMAND`, with more of them in `cli_session`, `cli_trace`, `cli_experiment`."""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

import burrlab
from burrlab._core import Burr, Material, Shape
from burrlab.cli_volume import SIGNED, add_label_options, add_volume_options, chosen_specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Options = argparse.Namespace


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """One line that names the option, exit status 2."""
        self.exit(2, f"{self.prog}: {message}\n")


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got '{text}'") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"must be finite, got '{text}'")
    return value


def _positive(text: str) -> float:
    value = _number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"must be positive, got '{text}'")
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number from 1, got '{text}'")
    return int(text)


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) >= 2**64:
        raise argparse.ArgumentTypeError(f"must be a whole number below 2^64, got '{text}'")
    return int(text)


def _pair(text: str) -> tuple[float, float]:
    values = [_positive(part) for part in text.split(",")]
    if len(values) != 2:
        raise argparse.ArgumentTypeError(f"must be C_E,ALPHA, got '{text}'")
    return values[0], values[1]


def _forces(text: str) -> list[float]:
    if ":" not in text:
        return [_positive(part) for part in text.split(",")]
    parts = text.split(":")
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"must be FIRST:LAST:COUNT or F,F,..., got '{text}'")
    return [float(f) for f in np.linspace(_positive(parts[0]), _positive(parts[1]), _count(parts[2]))]


def _shape(text: str) -> Shape:
    try:
        return Shape(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _output_options(parser: argparse.ArgumentParser, plot: bool = True) -> None:
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON; - for standard output")
    if plot:
        parser.add_argument("--plot", metavar="FILE", help="write a figure (PNG, PDF, SVG by its ending)")


def _material_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--material", choices=sorted(burrlab.materials), default="bone", help="default: bone")
    parser.add_argument("--c-e", type=_positive, help="elastic constant instead of the material's [N/mm^2]")
    parser.add_argument("--alpha", type=_positive, help="erosion rate instead of the material's [1/ms]")
    parser.add_argument(
        "--shape", type=_shape, help="erosion shape f: parabolic, linear, quartic, constant, power(k)"
    )
    parser.add_argument("--radius", type=_positive, default=3.0, help="burr radius R [mm], default 3")


def _experiment_options(parser: argparse.ArgumentParser) -> None:
    _material_options(parser)
    parser.add_argument("--voxel", type=_positive, help="voxel spacing [mm], default 0.1, or a volume's own")
    parser.add_argument("--dt", type=_positive, default=1.0, help="tick [ms], default 1")
    parser.add_argument("--seed", type=_seed, help="default: drawn and recorded")
    parser.add_argument("--scheme", choices=["layer", "cell"], default="layer", help="default: layer")
    parser.add_argument("--stop", type=_positive, help="immersion at which a run ends [mm], default R/3")
    parser.add_argument(
        "--max-duration", type=_positive, default=120.0, help="[s] of the experiment, default 120"
    )
    add_volume_options(parser)
    add_label_options(parser)


def _material(options: Options) -> Material:
    named = burrlab.materials[options.material]
    if options.c_e is None and options.alpha is None and options.shape is None:
        return named
    return Material(
        f"{named.name}, modified",
        c_e=named.c_e if options.c_e is None else options.c_e,
        alpha=named.alpha if options.alpha is None else options.alpha,
        shape=named.shape if options.shape is None else options.shape,
        source="command line",
    )


def _specimen(options: Options, burr: Burr) -> burrlab.Specimen | None:
    specimen = chosen_specimen(options, burr, _material(options))
    if specimen is not None or options.axis is None:
        return specimen
    return burrlab.half_space(burr, options.voxel or 0.1, depth=options.stop, axis=options.axis)


def _save(axes: Axes, path: str) -> None:
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.savefig(path, dpi=200)


def _check_outputs(options: Options) -> None:
    """ValueError before any work if a result could not be written."""
    taken: dict[Path, str] = {}
    for name in ("json", "plot", "out", "region", "profile", "record", "save", "template", "tsv"):
        path = getattr(options, name, None)
        if path is None or path == "-":
            continue
        folder = Path(path).resolve().parent
        if (
            not folder.is_dir()
            or not os.access(folder, os.W_OK)
            or (
                Path(path).is_dir() and name != "save"  # slices are saved as a folder
            )
        ):
            raise ValueError(f"--{name}: {path} cannot be written")
        if (other := taken.setdefault(Path(path).resolve(), name)) != name:
            raise ValueError(f"--{name} must be another file than --{other}, got {path}")
        if name in ("plot", "region", "profile"):
            from matplotlib.figure import Figure

            kinds = Figure().canvas.get_supported_filetypes()
            if Path(path).suffix[1:].lower() not in kinds:
                raise ValueError(f"--{name}: {path} must end in one of {', '.join(sorted(kinds))}")


def _deliver(options: Options, result: dict[str, Any], text: str) -> None:
    if options.json == "-":
        print(json.dumps(result, allow_nan=False))
        return
    if options.json is not None:
        Path(options.json).write_text(json.dumps(result, allow_nan=False, indent=1) + "\n")
    print(text)


def _descend(options: Options) -> int:
    burr, material = Burr(options.radius), _material(options)
    specimen = _specimen(options, burr)
    from tqdm import tqdm

    with tqdm(total=100, desc="descent", unit="%", disable=not sys.stderr.isatty(), leave=False) as bar:
        run = burrlab.descend(
            burr, material, options.force, voxel=options.voxel or 0.1, dt=options.dt, seed=options.seed,
            scheme=options.scheme, ideal=options.ideal, specimen=specimen, stop=options.stop,
            max_duration=options.max_duration, progress=lambda done: bar.update(int(100 * done) - bar.n),
        )  # fmt: skip
    if options.plot is not None:
        _save(run.plot()[0], options.plot)
    _deliver(options, run.to_dict(), f"{run!r}\nseed {run.provenance['seed']}")
    return 130 if run.status == "interrupted" else 0


def _sweep(options: Options) -> int:
    burr, material = Burr(options.radius), _material(options)
    curve = burrlab.force_sweep(
        burr, material, options.forces, repeats=options.repeats, voxel=options.voxel or 0.1, dt=options.dt,
        seed=options.seed, scheme=options.scheme, rig=options.rig, specimen=_specimen(options, burr),
        stop=options.stop, max_duration=options.max_duration, store=options.store, progress=sys.stderr.isatty(),
    )  # fmt: skip
    curve.to_csv(options.out)
    if options.plot is not None:
        _save(curve.plot(), options.plot)
    ok = int(curve.ok.sum())
    result = {
        "file": str(options.out),
        "n_points": len(curve),
        "n_ok": ok,
        "seed": curve.provenance["seed"],
        "version": burrlab.__version__,
        "warnings": curve.provenance["warnings"],
        "status": list(curve.status or ()),
    }
    lost = (curve.status or ()).count("interrupted")
    text = f"{len(curve)} descents, {ok} with a velocity, written to {options.out}; seed {result['seed']}"
    text += "".join(f"; {name}" for name in curve.provenance["warnings"])
    if lost:
        text += f"; {lost} interrupted"
        text += "" if options.store is None else f", the same command goes on from {options.store}"
    _deliver(options, result, text)
    return 130 if lost else 0


def _fit(options: Options) -> int:
    if options.store is not None and options.engine != "voxel":
        raise ValueError("--store goes with --engine voxel")
    result = burrlab.fit(
        _data(options), shape=options.shape, engine=options.engine, residuals=options.residuals,
        seed=options.seed, voxel=options.voxel, store=_store(options), progress=_bar(options),
    )  # fmt: skip
    given = {} if options.test is None else {"given": options.test}
    if options.plot is not None:
        _save(result.plot(alpha_lines=options.alpha_lines, log=options.log), options.plot)
    if options.region is not None:
        _save(result.plot_region(points=given), options.region)
    if options.profile is not None:
        _save(result.plot_profile(), options.profile)
    plain, text = result.to_dict(), result.report()
    if options.test is not None:
        test = result.test(*options.test)
        plain["test"] = {"c_e": options.test[0], "alpha": options.test[1], "p_value": test.p_value}
        text += f"\n    - {test}"
    _deliver(options, plain, text)
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


def _materials(options: Options) -> int:
    table = {
        name: {"c_e": m.c_e, "alpha": m.alpha, "shape": m.shape.name, "source": m.source}
        for name, m in burrlab.materials.items()
    }
    lines = [f"{'name':<10} {'c_e [N/mm^2]':>12} {'alpha [1/ms]':>12}  shape      source"]
    lines += [
        f"{n:<10} {m['c_e']:>12} {m['alpha']:>12}  {m['shape']:<10} {m['source']}" for n, m in table.items()
    ]
    _deliver(options, table, "\n".join(lines))
    return 0


def _version(options: Options) -> int:
    from burrlab.provenance import provenance

    _deliver(options, {"version": burrlab.__version__, **provenance()}, f"burrlab {burrlab.__version__}")
    return 0


def _join_vectors(arguments: Sequence[str]) -> list[str]:
    """`--entry -1,2,3` as `--entry=-1,2,3`: argparse takes a leading minus for an option."""
    joined: list[str] = []
    for text in arguments:
        if joined and joined[-1] in SIGNED and re.match(r"-[\d.]", text):
            joined[-1] += f"={text}"
        else:
            joined.append(text)
    return joined


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="burrlab", description="Virtual bone-burring experiments. Units: mm, N, s; dt in ms."
    )
    parser.add_argument("--version", action="version", version=f"burrlab {burrlab.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[Options], int], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(run=run)
        return sub

    descent = command(
        "descend", _descend, "Sink a burr at constant force and measure its penetration velocity."
    )
    descent.add_argument("--force", type=_positive, required=True, help="set-point [N]")
    descent.add_argument(
        "--ideal", action="store_true", help="hold the force exactly, without rig and controller"
    )
    _experiment_options(descent)
    _output_options(descent)

    sweep = command("sweep", _sweep, "Penetration velocity against force, written as CSV.")
    sweep.add_argument(
        "--forces", type=_forces, required=True, metavar="FIRST:LAST:COUNT", help="[N]; or F,F,..."
    )
    sweep.add_argument("--repeats", type=_count, default=1, help="descents at each force, default 1")
    sweep.add_argument("--out", required=True, metavar="FILE.csv")
    sweep.add_argument(
        "--rig", action="store_true", help="through controller and virtual rig; else the force is exact"
    )
    sweep.add_argument(
        "--store", metavar="FILE", help="keep every descent as it ends (JSON lines), and take from there what an earlier sweep of "
        "the same parameters and seed has done: an interrupted one goes on; needs --seed",
    )  # fmt: skip
    _experiment_options(sweep)
    _output_options(sweep)

    fit = command("fit", _fit, "Fit c_e and alpha, and say what the data determine.")
    fit.add_argument("file", metavar="FILE.csv", nargs="*", help="velocity-force curves")
    fit.add_argument("--radius", type=_positive, help="burr radius R of files that do not say it [mm]")
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
        "--shape", type=_shape, default=Shape("parabolic"), help="erosion shape f, default parabolic"
    )
    fit.add_argument("--engine", choices=["mean-field", "voxel"], default="mean-field")
    fit.add_argument("--residuals", choices=["relative", "absolute", "sigma"], default="relative")
    fit.add_argument("--voxel", type=_positive, default=0.1, help="voxel engine: spacing [mm]")
    fit.add_argument("--seed", type=_seed, default=0)
    fit.add_argument(
        "--alpha-lines", type=_positive, metavar="D", help="also draw alpha +- D [1/ms], as the paper does"
    )
    fit.add_argument("--log", action="store_true", help="logarithmic axes in the figure")
    fit.add_argument("--region", metavar="FILE", help="write a figure of the joint region of c_e and alpha")
    fit.add_argument("--profile", metavar="FILE", help="write a figure of c_e's profile likelihood")
    fit.add_argument("--test", type=_pair, metavar="C_E,ALPHA", help="are these in the joint region?")
    fit.add_argument("--store", metavar="FILE", help="voxel engine: keeps descents, the same command goes on")
    _output_options(fit)

    from burrlab.cli_experiment import add_experiment_commands
    from burrlab.cli_session import add_session_commands
    from burrlab.cli_tissues import add_tissues_command
    from burrlab.cli_trace import add_trace_commands
    from burrlab.cli_view import add_view_command

    add_session_commands(command)
    add_trace_commands(command)
    add_view_command(command)
    add_experiment_commands(command)
    add_tissues_command(command)
    _output_options(command("materials", _materials, "The paper's materials and their source."), plot=False)
    _output_options(command("version", _version, "Version and what it runs on."), plot=False)
    return parser


def _sentence(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None and error.strerror is not None:
        return f"{error.filename}: {error.strerror}"  # without the number of the error
    return " ".join(str(error).split())


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; 0 done (a run without a number too), 1 different or failed, 2 wrong input, 130 interrupted."""
    options = _parser().parse_args(_join_vectors(sys.argv[1:] if arguments is None else arguments))
    try:
        _check_outputs(options)
        return int(options.run(options))
    except (ValueError, OSError, ImportError) as error:
        print(f"burrlab {options.command}: {_sentence(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"burrlab {options.command}: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
