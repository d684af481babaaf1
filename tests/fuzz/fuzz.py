"""Hostile files and peers for every reader.

    python tests/fuzz/fuzz.py [TARGET ...] [--seconds 600] [--seed 1] [--out build/fuzz]
    python tests/fuzz/fuzz.py TARGET --only tests/fuzz/found/TARGET/NAME

An input is a folder of a few files: a seed (readers.py) with changes (mutations.py). A reader accepts it, or
refuses it by a ValueError or OSError with one sentence. Anything else is a finding: another error, no
sentence, a signal or an exit, more than 10 s or 2 GB, text on stdout or stderr. A child process reads the
inputs from memory. build/fuzz/TARGET keeps the findings, and NAME.txt their effect.
Earlier findings are in found/TARGET and are read first.
"""

import argparse
import faulthandler
import multiprocessing
import os
import re
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
from pathlib import Path
from random import Random

sys.path.append(str(Path(__file__).parents[1] / "python"))
from mutations import Files, changed, first
from readers import PACKAGE, TARGETS

FOUND = Path(__file__).parent / "found"
MEMORY, PATIENCE = 2 << 30, 10.0  # more than this is a finding [bytes], [s]
LONGEST = 20_000  # longest sentence [characters]: it may quote a name
CONTROL = re.compile(r"[\0-\x08\x0a-\x1f\x7f\ud800-\udfff]")  # a sentence has none, and no second line
ONE_CHILD = 200_000  # inputs per child
STATE = struct.Struct("<Qdd")  # number of the input, start of its reading (0: none is read) and time left [s]


def files_in(place: Path) -> Files:
    return {str(part.relative_to(place)): part.read_bytes() for part in place.rglob("*") if part.is_file()}


def inputs(folder: Path) -> list[Files]:
    return [files_in(place) for place in sorted(folder.glob("*/"))]


def put(files: Files, folder: Path) -> None:
    for part in folder.iterdir() if folder.is_dir() else ():
        shutil.rmtree(part) if part.is_dir() else part.unlink()
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def keep(files: Files, out: Path, name: str, told: str) -> None:
    if not (out / name).exists():
        put(files, out / name)
        (out / f"{name}.txt").write_text(told, errors="backslashreplace")


def address_space() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


class Child:
    def __init__(self, target: str, work: Path) -> None:
        self.read, self.work = TARGETS[target][0], work
        self.state = os.open(work / "state", os.O_RDWR)
        self.number, _, self.left = STATE.unpack(os.pread(self.state, STATE.size, 0))
        faulthandler.enable((work / "where").open("w"), all_threads=False)
        os.dup2(os.open(work / "said", os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND), 1)
        os.dup2(1, 2)

    def outcome(self, files: Files) -> tuple[str, str]:
        """Name of the finding, "" for none; and the error with its place, "" for none."""
        put(files, self.work / "input")
        os.chdir(self.work / "input")
        begun, name, told = time.monotonic(), "", ""
        os.pwrite(self.state, STATE.pack(self.number, begun, self.left), 0)
        try:
            self.read(first(files))
        except Exception as error:
            frames = [(frame.f_code, line) for frame, line in traceback.walk_tb(error.__traceback__)]
            own = [(code, line) for code, line in frames if code.co_filename.startswith(PACKAGE)] or frames
            told, text = f"{type(error)} {[(code.co_filename, line) for code, line in own]}", str(error)
            sentence = (
                text.strip() and not CONTROL.search(text) and len(text) < LONGEST and "alloc" not in text
            )
            if not sentence or not isinstance(error, (ValueError, OSError)):
                place = own[-1][0]
                name = f"{type(error).__name__}-{Path(place.co_filename).stem}-{place.co_name.strip('<>')}"
                told = "".join(traceback.format_exception(error))[-5000:]
        sys.stdout.flush()
        if os.fstat(1).st_size:
            text = re.sub(r".* so far; Ctrl-C ends it\n", "", os.pread(1, 5000, 0).decode(errors="replace"))
            os.ftruncate(1, 0)
            if text:  # but for a line of long work
                told, name = text, "said-" + re.sub(r"[\W\d]+", "-", text)[:40].strip("-")
        self.left -= time.monotonic() - begun
        os.pwrite(self.state, STATE.pack(self.number, 0.0, self.left), 0)
        return name, told

    def run(self, seed: int, found: list[Files], out: Path) -> None:
        made, left = inputs(self.work / "seeds"), self.left
        for files in made:  # also loads the readers' imports before memory is counted
            if told := self.outcome(files)[1]:
                (self.work / "where").write_text(f"a seed is refused, {first(files)}: {told}")
                raise SystemExit(2)
        self.left = left
        size = address_space()
        resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, -1))
        grows = not any(name.endswith(".h5") for name in made[0])  # no library can change broken HDF5
        corpus, ways, last = [*made, *(found if grows else [])], {""}, self.number + ONE_CHILD
        while self.number < len(found) or (
            self.left > 0
            and self.number < last
            and address_space() < size + MEMORY // 4 * 3  # libraries keep memory
        ):
            begun, r, again = time.monotonic(), Random(f"{seed} {self.number}"), self.number < len(found)
            files = found[self.number] if again else changed(r, r.choice(corpus), r.choice(corpus))
            self.left -= time.monotonic() - begun
            name, told = self.outcome(files)
            if name and not (out / name).exists():
                keep(files, out, name, told)
            if told not in ways and not name and grows and len(files[first(files)]) < 100_000:
                corpus.append(files)  # it took another way through the reader
            ways.add(told)
            self.number += 1
        os.pwrite(self.state, STATE.pack(self.number, 0.0, self.left), 0)


def run(target: str, seconds: float, seed: int, out: Path) -> tuple[int, list[str]]:
    """Number of inputs, and names of the findings; their inputs are in `out`."""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        work, left, number = Path(folder), seconds, 0
        for place, write in enumerate(TARGETS[target][1]):
            (work / f"seeds/{place}").mkdir(parents=True)
            write(work / f"seeds/{place}")
        (work / "state").write_bytes(STATE.pack(0, 0.0, seconds))
        while left > 0:  # a fork has the libraries loaded
            child = multiprocessing.get_context("fork").Process(
                target=lambda: Child(target, work).run(seed, inputs(FOUND / target), out)
            )
            child.start()
            hangs = False
            while child.is_alive():
                child.join(0.02)
                number, begun, left = STATE.unpack((work / "state").read_bytes())
                if begun and time.monotonic() - begun > PATIENCE:
                    hangs = True
                    os.kill(child.pid, signal.SIGABRT)  # faulthandler writes where
                    time.sleep(0.5)
                    child.kill()
            number, begun, left = STATE.unpack((work / "state").read_bytes())
            where = (work / "where").read_text()
            if begun:
                place = re.search(rf'"{PACKAGE}.*?(\w+)\.py", line \d+ in (\w+)', where)
                name = "hangs" if hangs else f"ends-{child.exitcode}"
                keep(
                    files_in(work / "input"), out, "-".join((name, *(place.groups() if place else ()))), where
                )
                left -= time.monotonic() - begun
                (work / "state").write_bytes(STATE.pack(number + 1, 0.0, left))
            elif child.exitcode:
                said = (work / "said").read_text(errors="replace")
                raise RuntimeError(f"{target} ends with {child.exitcode}: {where}{said}")
    return number, sorted(place.name for place in out.glob("*/"))


def main() -> int:
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("targets", nargs="*", help=f"of {', '.join(TARGETS)}")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("build/fuzz"))
    parser.add_argument("--only", type=Path)
    given, findings = parser.parse_args(), 0
    for target in given.targets or TARGETS:
        if given.only:
            put(files := files_in(given.only.absolute()), folder := Path(tempfile.mkdtemp()))
            os.chdir(folder)
            print(TARGETS[target][0](first(files)))
        else:
            number, names = run(target, given.seconds, given.seed, given.out.absolute() / target)
            findings += len(names)
            print(f"{target}: {number} inputs, {len(names)} findings", *names, flush=True)
    return int(findings > 0)


if __name__ == "__main__":
    sys.exit(main())
