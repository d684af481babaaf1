"""Results that must not change: each case makes what a user sees; frozen/NAME.json holds its first result.

    make golden CASE=fits      # shows how a case differs, and freezes it anew: say why in the commit

Earlier versions wrote `files/`: traces, kept bones, volumes of each format with their drilled pairs, a
store, an experiment with answers. Later versions read them.
"""

import contextlib
import hashlib
import json
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import burrlab

sys.path += [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "python")]  # golden, page_scenes
from page_scenes import make_page

import burrlab.view.page as page_calls
from burrlab.anatomy import mastoidectomy_path, temporal_bone
from burrlab.psychophysics import Protocol, analyse, read_folder
from burrlab.session.anatomy import anatomy_report
from burrlab.view.page_source import page_source
from burrlab.volume import load_drilled, read_stack
from golden.made_files import BONE, BURR, FILES, curve, make_files, run

FROZEN = Path(__file__).parent / "frozen"
CASES: dict[str, Callable[[Path], Any]] = {}


def case(make: Callable[[Path], Any]) -> Callable[[Path], Any]:
    CASES[make.__name__] = make
    return make


def frozen(name: str) -> Any:
    return json.loads((FROZEN / f"{name}.json").read_text(encoding="utf-8"))


def plain(value: Any) -> Any:
    """A value as JSON has it; a long array becomes its shape and two sums, this version's number "VERSION"."""
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, np.ndarray):
        if value.size <= 16 or value.dtype.kind not in "biuf":
            return plain(value.tolist())
        flat = np.nan_to_num(value.astype(float).ravel(), posinf=1e300, neginf=-1e300)
        sums = {"sum": float(flat.sum()), "moment": float(flat @ np.linspace(1, 2, flat.size))}
        rounding = 1e-13 * float(np.abs(flat).sum())  # of sums that cancel: it differs between machines
        return {"shape": list(value.shape)} | {
            name: total if abs(total) > rounding else 0.0 for name, total in sums.items()
        }
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, str):
        return value.replace(burrlab.__version__, "VERSION")
    return value if isinstance(value, int | float | bool | None) else repr(value)


def differences(before: Any, now: Any, at: str = "") -> Iterator[str]:
    """The differences of two values; numbers within a relative 1e-6 are equal."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in {**before, **now}:
            if key not in now or key not in before:
                yield f"{at}/{key}: {'is new' if key in now else 'is gone'}"
            else:
                yield from differences(before[key], now[key], f"{at}/{key}")
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for place, pair in enumerate(zip(before, now, strict=True)):
            yield from differences(*pair, f"{at}/{place}")
    elif isinstance(before, float) and isinstance(now, float | int) and not isinstance(now, bool):
        if not np.isclose(before, now, rtol=1e-6, atol=1e-12, equal_nan=True):
            yield f"{at}: {before!r} is {now!r} now"
    elif before != now or type(before) is not type(now):
        yield f"{at}: {before!r} is {now!r} now"


# ---- commands ----


COMMANDS = """
version --json version.json
descend --material bone --force 1 --radius 3 --voxel 0.3 --seed 1
descend --material pvc --force 1.5 --radius 2 --voxel 0.2 --seed 2 --json descent.json --plot descent.png
descend --material gold --force 1 --radius 3 --voxel 0.3
descend --material bone --force -1 --radius 3 --voxel 0.3
sweep --material bone --forces 0.8,1.2,1.6 --radius 3 --voxel 0.3 --repeats 2 --seed 4 --out sweep.csv --store sweep.jsonl
sweep --material bone --forces 0.8 --radius 3 --voxel 0.3 --seed 4 --out nowhere/sweep.csv
fit curve.csv --radius 3 --json fit.json
fit curve.csv
fit missing.csv --radius 3
fit text.txt --radius 3
session --device hand --voxel 0.5 --seed 3 --duration 0
replay trace.h5
replay text.txt
metrics trace.h5 --json metrics.json
metrics trace.h5 --plot metrics.png
export trace.h5 --out export.hdf5
view trace.h5 --pictures slices.png
view trace.h5 --volume grey.nrrd
tissues labels.nrrd --json labels.json
tissues labels.nrrd --template tissues.csv
tissues tissues.csv
tissues text.txt
experiment new new.toml
experiment power experiment.toml
experiment run experiment.toml --simulated --all --fast
experiment run experiment.toml --simulated --all --fast
experiment analyse experiment.toml --json analysis.json --tsv analysis.tsv
experiment analyse new.toml
burr
design fit.json --forces 0.5,2 --static 0.2 --seed 1
""".strip().splitlines()
#: Texts that differ between runs or machines.
VARIES = [
    (r"(/[\w.-]+)+/(?=[\w-]+\.\w)", ""), (r"function evals +=.*|\d+ in [\d.]+ s\b", "EVALUATIONS"), (r"burrlab \d+\.\d+\.\d+\S*", "burrlab VERSION"), (r"\b\d+(\.\d+)? (us|ms of CPU)", "TIME us"),
    (r"(BOBYQA .*) \d+(?=  [A-Z]+_)", r"\1 EVALUATIONS"), (r"(?<=>)\d+\.\d{12,}(?=<)", lambda digits: f"{float(digits[0]):.9g}"),
    (r"seed \d{6,}", "seed DRAWN"), (r"(?m)^  (tick|period|after|follower|real-time|timer|burr \d+: energy).*$", "  VARIES"),
    (r"(?m)^(.* so far|.*: about .* more); Ctrl-C ends it\n", ""), (r"\d\d:\d\d:\d\d", "CLOCK"), (r"\d{4}-\d\d-\d\d\S*", "DATE"),
]  # fmt: skip


def told(text: str) -> list[str]:
    for pattern, instead in VARIES:
        text = re.sub(pattern, instead, text)
    return text.splitlines()


def numbers(text: str) -> list[float]:
    """The numbers in a text, apart from those that differ between runs."""
    return [
        float(digits) for digits in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?", "\n".join(told(text)))
    ]


def keys(value: Any) -> Any:
    """Keys of a JSON and types of its values; a list becomes the set of its types."""
    if isinstance(value, dict):
        return {key: keys(one) for key, one in value.items()}
    if isinstance(value, list):
        return [json.loads(one) for one in sorted({json.dumps(keys(one)) for one in value})]
    return "number" if type(value) in (int, float) else type(value).__name__


@case
def commands(folder: Path) -> Any:
    """Exit status and files of right and wrong commands, in turn in one folder; numbers and JSON keys that no result has."""
    for name in ("trace.h5", "curve.csv", "labels.nrrd", "grey.nrrd", "experiment.toml"):
        shutil.copy(FILES / name, folder)
    (folder / "text.txt").write_text("no table\n")
    found = {}
    with contextlib.chdir(folder):
        for place, line in enumerate(COMMANDS, 1):
            before = {p.name: p.stat().st_mtime_ns for p in folder.iterdir()}
            status, out, _ = run(*line.split())
            written = sorted(p.name for p in folder.iterdir() if before.get(p.name) != p.stat().st_mtime_ns)
            found[f"{place:02} {line}"] = {
                "status": status,
                "out": unless_of_result(json.loads(out)) if out.startswith("{") else unless_of_result(out),
                "written": written,
                **{
                    name: unless_of_result(json.loads((folder / name).read_text()))
                    for name in written
                    if name.endswith(".json")
                },
            }
    return found


def unless_of_result(printed: Any) -> Any:
    """The keys of a JSON or the numbers in a text; or which result they are of, whose own are in the case `results`."""
    content, part = (numbers(printed), "numbers") if isinstance(printed, str) else (keys(printed), "keys")
    same = (name for name, parts in results(FILES).items() if content and parts.get(part) == content)
    return next((f"the {part} of {name}" for name in same), content)


# ---- results ----


@case
def descents(_: Path) -> Any:
    """Velocity, window and status of ten descents."""
    kinds = [
        ("bone", 1.0, 3.0, 0.3, {}), ("bone", 2.0, 3.0, 0.2, {}), ("pvc", 1.5, 2.0, 0.2, {}), ("pettigrew", 0.6, 1.5, 0.15, {}),
        ("bone", 1.0, 3.0, 0.3, {"settings": burrlab.DescentSettings(scheme="cell")}), ("bone", 1.0, 3.0, 0.3, {"ideal": True}), ("bone", 1.0, 2.0, (0.2, 0.3, 0.2), {}),
        ("bone", 1.0, 3.0, 0.3, {"settings": burrlab.DescentSettings(dt=0.5)}), ("bone", 9.0, 3.0, 0.3, {}), ("bone", 0.02, 3.0, 0.3, {"settings": burrlab.DescentSettings(max_duration=2.0)}),
    ]  # fmt: skip
    runs = [
        burrlab.descend(
            burrlab.Burr(radius), burrlab.materials[material], force, voxel=voxel, seed=i, **options
        )
        for i, (material, force, radius, voxel, options) in enumerate(kinds)
    ]
    return {
        str(i): plain({key: value for key, value in run.to_dict().items() if key != "provenance"})
        for i, run in enumerate(runs)
    }


@case
def fits(_: Path) -> Any:
    """Fits of several kinds of data, residuals, models and statuses."""
    data = curve()
    flat = burrlab.synthetic_curve(BURR, BONE, [0.8, 0.85, 0.9], repeats=2, scatter=0.08, seed=3)
    presses = burrlab.synthetic_indentation(BURR, BONE, [0.05, 0.1, 0.15], seed=1)
    sinking = [burrlab.synthetic_trace(BURR, BONE, force, seed=5) for force in (0.8, 1.2, 1.6)]
    made = {
        "curve": burrlab.fit(data, BURR), "close forces": burrlab.fit(flat, BURR),
        "with indentation": burrlab.fit([data, presses], BURR),
        **{f"residual {kind}": burrlab.fit(data, BURR, residuals=kind) for kind in ("relative", "absolute")},
        "quartic": burrlab.fit(data, BURR, law="quartic"),
        "traces": burrlab.fit(sinking, BURR),
    }  # fmt: skip
    kept = (
        "c_e",
        "alpha",
        "residual",
        "residuals",
        "predicted",
        "n_points",
        "n_censored",
        "status",
        "intervals",
        "identified",
        "lack_of_fit",
        "fall",
    )
    return {name: {key: plain(result.to_dict()[key]) for key in kept} for name, result in made.items()}


@cache
def objects() -> dict[str, Any]:
    """One of each result that prints or plots itself."""
    trace = burrlab.load_trace(FILES / "trace.h5")
    data = curve()
    fit = burrlab.fit(data, BURR)
    return {
        "curve": data, "fit": fit, "descent": burrlab.descend(BURR, BONE, 1.0, voxel=0.3, seed=1),
        "indentation": burrlab.synthetic_indentation(BURR, BONE, [0.05, 0.1, 0.15], seed=1),
        "depth trace": burrlab.synthetic_trace(BURR, BONE, 1.0, seed=5), "mean field": burrlab.mean_field_descent(BURR, BONE, 1.0),
        "laws": burrlab.compare_laws(data, BURR), "trace": trace, "metrics": burrlab.session_metrics(trace),
        "replay": burrlab.replay(trace), "anatomy": anatomy_report(trace), "answers": read_folder(FILES / "experiment")[0],
        "analysis": analyse(Protocol.read(FILES / "experiment.toml"), simulated=True), "volume": burrlab.read_volume(FILES / "grey.nrrd"), "labels": burrlab.read_labels(FILES / "labels.nrrd"),
        "bone": burrlab.load_bone(FILES / "bone.h5")[0], "material": BONE, "burr": BURR,
    }  # fmt: skip


@case
@cache
def results(_: Path) -> Any:
    """Of each result its keys in JSON, with the types of their values, and the numbers that it prints."""
    return {
        name: ({"keys": keys(plain(result.to_dict()))} if hasattr(result, "to_dict") else {})
        | {"numbers": numbers(repr(result))}
        for name, result in objects().items()
    }


@case
def texts(_: Path) -> Any:
    """Three short snapshots of what is printed: a help, an object, a report."""
    status, usage, _ = run("descend", "--help")
    fit = objects()["fit"]
    return {
        "help": [status, *re.findall(r"--[\w-]+", usage)],
        "repr": told(repr(fit)),
        "report": told(fit.report()),
    }


@case
def plots(folder: Path) -> Any:
    """Labels of the axes and data of each figure."""
    from matplotlib import pyplot

    found = {}
    for name, one in objects().items():
        for way in (member for member in dir(one) if member == "plot" or member.startswith("plot_")):
            with contextlib.suppress(ValueError):  # a figure that this result lacks
                made = getattr(one, way)()
                found[f"{name}.{way}"] = [
                    {
                        "labels": [axes.get_xlabel(), axes.get_ylabel()],
                        "scales": [axes.get_xscale(), axes.get_yscale()],
                        "lines": [[plain(np.asarray(line.get_xdata())), plain(np.asarray(line.get_ydata()))] for line in axes.lines],
                        "collections": [[type(c).__name__, plain(np.asarray(c.get_offsets()))] for c in axes.collections],
                        "images": [plain(np.asarray(image.get_array())) for image in axes.images], "patches": len(axes.patches),
                    }
                    for axes in (made if isinstance(made, list) else [made])
                ]  # fmt: skip
            pyplot.close("all")
    return found


# ---- files and wires ----


def _layouts(folder: Path) -> Any:
    """Names, types and attributes in HDF5 files, and the lines of a store."""
    found: dict[str, Any] = {}
    for path in (folder / "trace.h5", folder / "bone.h5", *folder.glob("drilled.nrrd.*.h5")):
        with h5py.File(path) as file:
            held: dict[str, Any] = {"/": file}
            file.visititems(lambda name, item, held=held: held.__setitem__(name, item))
            found[path.name[:12]] = {
                name: {
                    "type": re.sub(r"\|S\d+", "text", str(getattr(item, "dtype", "group"))), "rank": len(getattr(item, "shape", ())),
                    "attributes": {key: str(np.asarray(value).dtype.kind) for key, value in sorted(item.attrs.items())},
                }
                for name, item in held.items()
            }  # fmt: skip
    stored = (folder / "store.jsonl").read_text().splitlines()
    return {**found, "store": [keys(json.loads(line)) for line in stored if line]}


@case
def layouts(_: Path) -> Any:
    """Layouts of the frozen files."""
    return _layouts(FILES)


@case
def written(folder: Path) -> Any:
    """Layouts of newly written files."""
    make_files(folder)
    return _layouts(folder)


@case
def read(_: Path) -> Any:
    """Contents of the frozen files: values, digests, replays, answers."""
    bone, tick = burrlab.load_bone(FILES / "bone.h5")
    traces = {
        name: burrlab.load_trace(FILES / f"{name}.h5") for name in ("trace", "trace3")
    }  # formats 2 and 3
    found: dict[str, Any] = {
        **{name: [_digest(t.ticks), t.digests, t.seed, t.scheme, plain(t.watch), burrlab.replay(t).equal] for name, t in traces.items()},
        "metrics": burrlab.session_metrics(traces["trace3"]).to_dict(),
        "bone": [bone.digest(), tick, plain(np.array([bone.spacing, bone.origin]))],
        "answers": [plain(vars(row)) for one in read_folder(FILES / "experiment") for row in one.rows],
        "store": len(burrlab.Store(FILES / "store.jsonl")), "fit": burrlab.Fit.from_json(FILES / "fit.json").to_dict()["intervals"],
        "descent": burrlab.Descent.load(FILES / "descent.npz").penetration_velocity,
        "curve": plain(burrlab.VelocityCurve.from_csv(FILES / "curve.csv").velocity),
    }  # fmt: skip
    for path in sorted(FILES.glob("grey*")):
        if path.suffix not in (".raw", ".img"):
            volume = burrlab.read_volume(path)
            found[path.name] = [_digest(volume.values), [volume.spacing, volume.origin, volume.direction]]
    for path in sorted(FILES.glob("drilled*")):
        if not path.name.endswith(".h5"):
            pair = load_drilled(path)
            found[path.name] = [pair.bone.digest(), pair.tick, _digest(burrlab.read_volume(path).values)]
    for path, labels in (("labels.nrrd", burrlab.read_labels), ("slices.yaml", read_stack)):
        made = labels(FILES / path)
        found[path] = [_digest(made.labels), made.names, made.colours]
    return plain(found)


def _digest(values: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:16]


@case
def ear(_: Path) -> Any:
    """A phantom, and a mastoidectomy of it."""
    made = temporal_bone((0.15, 0.5, 0.5), seed=3)
    return {"landmarks": made.landmarks, "bone": [made.bone.density, made.labels, made.target]} | vars(
        mastoidectomy_path(made, BURR, layer=1.5, step=2.0)
    )


@case
def page(_: Path) -> Any:
    """State that the page sends to a browser, and calls that a browser may send."""
    made = make_page(page_source(burrlab.load_trace(FILES / "trace.h5")))
    made.state.tell("wanted_s", 0.9)
    made._turn(1.0)
    state = {key: value for key, value in made.state.items() if not str(value).startswith("data:")}
    return {
        "wishes": sorted(page_calls.WISHES),
        "triggers": sorted(made.server.triggers),
        "state": plain(state),
    }


def main() -> None:
    """Freezes the cases that are named, or new ones; shows how they differ from what was frozen."""
    os.environ.setdefault("MPLBACKEND", "Agg")
    if not (FILES / "trace.h5").exists():
        make_files(FILES)
    for name, make in CASES.items():
        path = FROZEN / f"{name}.json"
        if name not in sys.argv[1:] and (path.exists() or sys.argv[1:]):
            continue
        with tempfile.TemporaryDirectory() as folder:
            now = plain(make(Path(folder)))
        print(*(differences(frozen(name), now) if path.exists() else [f"{name} is new"]), sep="\n")
        path.write_text(json.dumps(now, indent=0, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
