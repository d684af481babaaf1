"""Cost of a tick: the core and a plain C++ loop, on one thread, with the same random bits.

    python tests/bench/bench.py --library build/burrlab_bench.so [--out bench] [--quick | --waits]

Writes results.json and tick.png. First it compares all implementations with tests/reference/tick.py; a
difference in one bit ends the run with an error. --waits prints where a researcher waits instead (waits.py).
"""

import datetime
import itertools
import json
import platform
import re
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # for `reference`

import numpy as np
import report
import tissues
import waits
from check import check_all
from measure import measure, volume_scaling
from native import Native
from options import options
from plot import draw
from scenes import growing
from times import on_one_core

import burrlab


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def machine(native: Native) -> dict[str, Any]:
    """Processor, compiler and versions."""
    information = Path("/proc/cpuinfo")
    named = re.search(
        r"^model name.*?: *(.*)", information.read_text() if information.exists() else "", re.MULTILINE
    )
    return {
        "cpu": named[1] if named else platform.processor() or "unknown",
        "cpu_paths": native.cpu_paths,
        "compiler": native.library.bench_compiler().decode(),
        "flags": native.library.bench_flags().decode(),
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "versions": {"burrlab": burrlab.__version__, "numpy": np.__version__},
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def run(native: Native, quick: bool, reference: str) -> dict[str, Any]:
    """All measurements; `reference` is the CPU path that the others are compared with."""
    weighed = ("slide 25", "buried 25") if quick else ("slide 50", "buried 50")
    scenes = {}
    with on_one_core():
        for scene in growing(quick):
            say(f"  {scene.name}")
            scenes[scene.name] = measure(native, scene, reference, weighed=scene.name in weighed)
        say("  bandwidth, volume, tissues")
        bandwidth = max(
            native.bandwidth(2**25 if quick else 2**29, copy=copy)  # beyond the caches
            for copy in (False, True)
        )
        return {
            "scenes": scenes,
            "bandwidth_GB_per_s": bandwidth,
            "limits": report.limits(scenes, bandwidth, reference),
            "volume": volume_scaling(native, reference, quick),
            "tissues": tissues.tissue_cost(native, quick),
        }


def main() -> None:
    chosen = options(
        (__doc__ or "").partition("\n")[0],
        library={"type": Path, "required": True, "help": "the built bench library"},
        out={"type": Path, "default": Path("bench"), "help": "folder of results.json and tick.png"},
        quick={"action": "store_true", "help": "small scenes, few ticks: does it run?"},
        waits={"action": "store_true", "help": "where a researcher waits, instead of ticks"},
    )
    native = Native(chosen.library)
    if chosen.waits:
        folder = chosen.out / "waits"
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
        "quick": chosen.quick,
        "compared_with_reference": comparisons,
        "reference_path": reference,
        "left_out": missing,
        **run(native, chosen.quick, reference),
    }
    here = results["machine"]
    print(f"{here['cpu']}, {here['compiler']} {here['flags']}, burrlab {burrlab.__version__}")
    if missing:
        print(f"Left out, as this CPU has none: {', '.join(missing)}")
    print(*report.table(results), *report.summary(results), sep="\n")
    chosen.out.mkdir(parents=True, exist_ok=True)
    results["seconds"] = time.perf_counter() - begun
    (chosen.out / "results.json").write_text(json.dumps(results, indent=2, allow_nan=False) + "\n")
    about = f"median over ticks, one thread; {here['cpu']}, {here['compiler']}, burrlab {burrlab.__version__}"
    draw(results, about, chosen.out / "tick.png")
    say(f"{chosen.out}/results.json, {chosen.out}/tick.png; {results['seconds']:.0f} s")


if __name__ == "__main__":
    main()
