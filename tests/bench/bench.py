"""Cost of a tick: the core, a plain C++ loop and Numba, on one thread, with the same random bits.

    python tests/bench/bench.py --library build/burrlab_bench.so [--out bench] [--quick | --waits]

Writes results.json and tick.png. First it compares all implementations with tests/reference/tick.py; a
difference in one bit ends the run with an error. --waits prints where a researcher waits instead (waits.py).
"""

import argparse
import itertools
import json
import sys
import time
from math import isfinite
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # for `reference`

import experiments
import report
import tissues
import waits
from check import check_all
from machine import machine, on_one_core
from measure import measure
from native import Native
from plot import draw
from scenes import RESOLUTIONS, growing

SPLIT_SCENES = ("slide 50", "buried 50")  # also timed in two passes and compared with memory bandwidth


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def run(native: Native, quick: bool, reference: str) -> dict[str, Any]:
    """All measurements; `reference` is the CPU path that baselines are compared with."""
    split = ("slide 25", "buried 25") if quick else SPLIT_SCENES
    scenes, once = {}, {}
    with on_one_core():
        for scene in growing(quick):
            say(f"  {scene.name}")
            passes = reference if scene.name in split else None
            scenes[scene.name] = measure(native, scene, reference, passes=passes)
        for resolution in (12.5,) if quick else RESOLUTIONS:
            say(f"  descent {resolution:g}")
            name, found = experiments.descent_scene(native, resolution, reference, quick)
            scenes[name] = found
        say("  call from Python, bandwidth")
        once["python_step"] = experiments.python_step(native, quick)
        once["bandwidth"] = experiments.bandwidth(native, quick)
        once["limits"] = report.limits(scenes, once["bandwidth"], reference)
        say("  volume")
        once["volume"] = experiments.volume_scaling(native, reference, quick)
        say("  tissues")
        once["tissues"] = tissues.tissue_cost(native, quick)
    say("  sweep")
    once["sweep"] = experiments.sweep(quick)
    slopes = {
        kind: {
            name: report.exponent(*curve) for name, curve in report.growth({"scenes": scenes}, kind).items()
        }
        for kind in ("slide", "buried")
    }
    exponents = {
        kind: {name: k for name, k in found.items() if isfinite(k)} for kind, found in slopes.items()
    }
    return {"scenes": scenes, "exponents": exponents, **once}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--library", type=Path, required=True, help="the built bench library")
    parser.add_argument("--out", type=Path, default=Path("bench"), help="folder of results.json and tick.png")
    parser.add_argument("--quick", action="store_true", help="small scenes, few ticks: does it run?")
    parser.add_argument("--waits", action="store_true", help="where a researcher waits, instead of ticks")
    options = parser.parse_args()
    native = Native(options.library)
    if options.waits:
        folder = options.out / "waits"
        for line in itertools.chain(waits.lines(folder), waits.longest_ticks(folder, native)):
            print(line, flush=True)
        return
    begun = time.perf_counter()
    say("Equal to the reference, bit for bit?")
    comparisons = check_all(native)
    say(f"yes, in {comparisons} comparisons\nScenes:")
    reference = "avx2" if "avx2" in native.cpu_paths else native.cpu_paths[-1]
    missing = [path for path in ("portable", "avx2", "avx512") if path not in native.cpu_paths]
    results = {
        "machine": machine(native),
        "quick": options.quick,
        "compared_with_reference": comparisons,
        "reference_path": reference,
        "left_out": missing,
        **run(native, options.quick, reference),
    }
    results["targets"] = report.targets(results)
    here = results["machine"]
    print(f"{here['cpu']}, {here['compiler']} {here['flags']}, burrlab {here['burrlab']}")
    if missing:
        print(f"Left out, as this CPU has none: {', '.join(missing)}")
    print(*report.table(results), *report.summary(results), sep="\n")
    options.out.mkdir(parents=True, exist_ok=True)
    results["seconds"] = time.perf_counter() - begun
    (options.out / "results.json").write_text(json.dumps(results, indent=2, allow_nan=False) + "\n")
    about = f"median over ticks, one thread; {here['cpu']}, {here['compiler']}, burrlab {here['burrlab']}"
    draw(results, about, options.out / "tick.png")
    say(f"{options.out}/results.json, {options.out}/tick.png; {results['seconds']:.0f} s")


if __name__ == "__main__":
    main()
