"""Fixtures that the tests share."""

import functools
import gc
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from burrlab import Burr, BurrContact, VoxelBone, _core, materials

pytest.register_assert_rewrite("tick_scenes")

ROOT = Path(__file__).parents[2]
os.environ["BURRLAB_CACHE"] = ""  # nothing is kept between tests
gc.set_threshold(20_000, 20, 20)  # by default 3.6 s of a worker's 13 s to collect all tests
# Otherwise each process that a test starts compiles all modules again, up to 1.7 s.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


@pytest.fixture(scope="session", autouse=True)
def _signals_are_heard() -> Iterator[None]:
    """Whoever runs the tests in the background may ignore these signals, and every child would inherit that."""
    handlers = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(autouse=True)
def _no_figures_left() -> Iterator[None]:
    """Closes all figures: pyplot keeps open ones, and warns at the twenty-first."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture(autouse=True)
def _patient_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine a thread may wait longer than the watchdog, whose tests make their own loops."""
    monkeypatch.setattr(
        "burrlab.session.session.HapticLoop", functools.partial(_core.HapticLoop, stall_limit=9000.0)
    )


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The test's own folder, in which it works."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(params=_core.cpu_paths())
def cpu_path(request, keep_cpu_path):
    """Each CPU path of the tick in turn; restores the path that was in use."""
    _core.use_cpu_path(request.param)
    return request.param


@pytest.fixture
def keep_cpu_path():
    """Restores the CPU path after a test that chooses its own."""
    before = _core.cpu_path()
    yield before
    _core.use_cpu_path(before)


@pytest.fixture
def eroded_bone():
    """A small block with a dent in it."""
    bone = VoxelBone.block((3, 3, 2), 0.1, origin=(-1.45, -1.45, -1.95))
    contact = BurrContact(bone, Burr(1.0), materials["bone"], seed=1)
    for _ in range(10):
        contact.step((0.0, 0.0, 0.8), 1.0)
    assert bone.removed > 0
    return bone


@pytest.fixture
def shared_data():
    """Folder of local test data, which is not part of the project; skips without it."""
    folder = Path(os.environ.get("BURRLAB_SHARED", ROOT.parent / "shared")) / "data"
    if not folder.is_dir():
        pytest.skip(f"local test data is not here: {folder} (set BURRLAB_SHARED)")
    return folder


@pytest.fixture(scope="session")
def build(tmp_path_factory):
    """Compiles a program against libopenigtlink; skips without it."""
    headers = Path("/usr/include/openigtlink")
    compiler = shutil.which("c++") or shutil.which("g++")
    if not headers.is_dir() or compiler is None:
        pytest.skip("libopenigtlink-dev and a C++ compiler are needed")
    folder = tmp_path_factory.mktemp("openigtlink")

    def compile_program(source: Path) -> str:
        program = folder / source.stem
        if not source.is_file():
            pytest.skip(f"openigtlink-examples is needed: no {source}")
        if not program.exists():
            subprocess.run(
                [compiler, "-w", "-O1", f"-I{headers}", source, "-o", program, "-lOpenIGTLink", "-lpthread"],
                check=True,
            )
        return str(program)

    return compile_program


@pytest.fixture
def pyigtl():
    """The package, with the signal handlers that its server replaces put back."""
    module = pytest.importorskip("pyigtl", reason="pyigtl is needed")  # its warnings are ignored
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield module
    for number, handler in before.items():
        signal.signal(number, handler)
