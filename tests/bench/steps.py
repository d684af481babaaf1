"""Where the time of a tick goes, by step: samples of the clock in the tick's own code, in the quietest of several
turns.

    python tests/bench/steps.py before=OLD/burrlab_bench.so now=build/burrlab_bench.so --png docs/tick_steps.png

Needs `perf`, and libraries with line tables: `cmake -S . -B build -DBURRLAB_BENCH=ON -DCMAKE_CXX_FLAGS=-g1`.
"""

import argparse
import functools
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from native import Core, Native
from scenes import Scene, buried, slide
from times import on_one_core

from burrlab.common.figures import new_figure, tidy

#: Steps, and the functions whose time is theirs.
STEPS = {
    "bricks: walk, stored sums": ("walk_bricks", "pass", "close", "open", "at_brick"),
    "rows: distances, which": ("measure", "wanted_units", "visit"),
    "coverage, mass, sums": ("meet", "meet_deep", "add", "add_up"),
    "fraction left, place in G": ("find_cells",),
    "effective depth, f": ("find_f", "raise"),
    "random numbers": ("draw_slabs", "draw"),
    "loss": ("lose", "settle_ties"),
    "sums of the levels left": ("sum_levels",),
}
SCENES = {
    "slide": functools.partial(slide, 5.0, 0.1, ticks=3000),
    "buried": functools.partial(buried, 5.0, 0.1),
}


def run(library: Path, path: str, scene: Scene) -> float:
    """Median time of a tick [us]."""
    with on_one_core():
        core = Core.of(Native(library), scene.levels(), scene.burring, path)
        turns = 10 if scene.fresh else 1
        times = [core.run_fresh(scene.path) if scene.fresh else core.run(scene.path) for _ in range(turns)]
    return 1e6 * float(np.median(np.concatenate([one.seconds for one in times])))


def sampled(library: Path, path: str, scene: str) -> dict[str, float]:
    """Time of each step [us]."""
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "perf.data"
        this = [sys.executable, __file__, "--run", str(library), path, scene]
        perf = ["perf", "record", "-q", "-e", "cpu-clock", "-F", "8000", "-o", str(record), *this]
        median = float(_told(perf))
        shown = _told(["perf", "script", "-F", "ip,sym,dso", "--show-mmap-events", "-i", str(record)])
    start, places = None, Counter[int]()
    code = rf"\[0x([0-9a-f]+)\(0x[0-9a-f]+\) @ (?:0x)?([0-9a-f]+) .*r-xp .*{library.name}"
    for line in shown.splitlines():
        if mapped := re.search(code, line):
            start = int(mapped[1], 16) - int(mapped[2], 16)
        elif library.name in line and start is not None:
            places[int(line.split()[0], 16) - start] += 1
    asked = "".join(f"{place:#x}\n" for place in places)
    lines = _told(["addr2line", "-i", "-f", "-C", "-a", "-e", str(library)], asked)
    samples: Counter[str] = Counter()
    chains = re.split(r"^0x[0-9a-f]+\n", lines, flags=re.MULTILINE)[1:]
    for chain, count in zip(chains, places.values(), strict=True):
        samples[_step(chain.splitlines())] += count
    samples.pop("", None)  # the table of G, making the bone
    return {step: median * samples[step] / samples.total() for step in STEPS}


def _step(chain: Sequence[str]) -> str:
    """The step of an address: of the innermost function of a step, by name or by the lines of its source."""
    for function, place in zip(chain[::2], chain[1::2], strict=True):
        name = re.search(r"(\w+)(?:<|\(|$)", function.replace("(anonymous namespace)::", ""))
        file, _, line = place.partition(" ")[0].rpartition(":")
        names = {name[1] if name else ""}
        if file.endswith((".hpp", "tick.cpp")) and line.isdecimal() and "/kernel/" in file:
            names = {_functions(file)[int(line) - 1]}
        if found := [step for step, own in STEPS.items() if names & set(own)]:
            return found[0]
    return ""


@functools.cache
def _functions(file: str) -> list[str]:
    """The function that each line of a file belongs to."""
    name, names = "", []
    for line in Path(file).read_text().splitlines():
        if found := re.match(r"(?:inline|void|BURRLAB_\w+)\b[^=;]*?(\w+)\(", line):
            name = found[1]
        names.append(name)
    return names


def _told(command: Sequence[str], given: str | None = None) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True, input=given).stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("libraries", nargs="+", metavar="NAME=LIBRARY")
    parser.add_argument("--png", type=Path, metavar="FILE")
    parser.add_argument("--turns", type=int, default=7)
    options = parser.parse_args()
    libraries = [tuple(text.split("=", 1)) for text in options.libraries]
    figure = new_figure(7.0, 4.2)
    panels = figure.subplots(1, len(SCENES))
    for axes, scene in zip(panels, SCENES, strict=True):
        bars = [(path, name, library) for path in ("avx2", "avx512") for name, library in libraries]
        turns = [
            [sampled(Path(library), path, scene) for path, _, library in bars] for _ in range(options.turns)
        ]
        quietest = [min(of_bar, key=lambda times: sum(times.values())) for of_bar in zip(*turns, strict=True)]
        bottom = np.zeros(len(bars))
        for k, step in enumerate(STEPS):
            height = [times[step] for times in quietest]
            print(f"{scene:<8} {step:<28}", *(f"{one:8.1f}" for one in height), "us")
            axes.bar(range(len(bars)), height, bottom=bottom, label=step, color=f"C{k}")
            bottom += height
        axes.set_xticks(range(len(bars)), [f"{path[3:]}\n{name}" for path, name, _ in bars], fontsize=8)
        axes.set_title(f"{scene}, R = 5 mm, 0.1 mm", fontsize=10)
        axes.set_ylabel("time of a tick, median [µs]")
        axes.set_xlabel("AVX")
        tidy(axes)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside right center", fontsize=8, frameon=False)
    if options.png:
        figure.savefig(options.png, dpi=200)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--run"]:
        print(run(Path(sys.argv[2]), sys.argv[3], SCENES[sys.argv[4]]()))
    else:
        main()
