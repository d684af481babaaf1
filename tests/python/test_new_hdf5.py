"""HDF5 files on a disk that is or becomes full: an error, and a process that continues and ends normally."""

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from session_scenes import ended, session_of, tools

import burrlab
from burrlab.common.files import new_hdf5

resource = pytest.importorskip("resource", reason="limits of a process are POSIX")
#: A file-size limit: for a process the same as a full disk.
LIMITED = """
import resource, sys
from pathlib import Path
import burrlab
from burrlab.session.trace import make_compact
def limit(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
trace, part, sizes = Path(sys.argv[1]), Path(sys.argv[2]), map(int, sys.argv[3:])
bone = burrlab.VoxelBone.block((30, 30, 10), 0.2)
for size in sizes:
    limit(size)
    try:
        make_compact(trace, part)
    except OSError as error:
        print("compact", error.strerror, error.filename)
    try:
        burrlab.Session(
            bone, (burrlab.Burr(2.0), burrlab.materials["bone"]), burrlab.HandDevice((15, 15, 12)), seed=1,
            duration=1.0, record=part.with_name("new.h5"), clock=burrlab.Clock(wall_clock=False),
        )
    except OSError as error:
        print("new", error.strerror, error.filename)
limit(resource.RLIM_INFINITY)
burrlab.save_bone(part.with_name("bone.h5"), bone)
"""


def test_a_full_disk_leaves_the_process_whole(tmp_path: Path) -> None:
    trace, part, bone = tmp_path / "trace.h5", tmp_path / "part", burrlab.VoxelBone.block((8, 8, 4), 0.2)
    ended(session_of(
        bone, tools(), burrlab.HandDevice((4.0, 4.0, 6.0)), seed=1, duration=2.0, record=trace, wall_clock=False
    ))  # fmt: skip
    sizes = [str(size) for size in (0, 4096, 8192, 16384, 24576, 32768)]
    run = subprocess.run(
        [sys.executable, "-c", LIMITED, str(trace), str(part), *sizes], capture_output=True, text=True, check=False,
        env={"PYTHONPATH": ":".join(sys.path)},
    )  # fmt: skip
    assert (run.returncode, run.stderr) == (0, "")
    lines = [
        f"{what} File too large {file}" for what, file in (("compact", part), ("new", tmp_path / "new.h5"))
    ]
    assert run.stdout.splitlines() == lines * len(sizes)
    assert burrlab.load_bone(tmp_path / "bone.h5")[0].shape == (50, 150, 150)
    assert burrlab.load_trace(trace).complete


def test_what_else_goes_wrong_is_told(tmp_path: Path) -> None:
    for error in (KeyError("mine"), OSError("other")):
        with pytest.raises(type(error), match=error.args[0]), new_hdf5(tmp_path / "a.h5"):
            raise error
    with pytest.raises(FileNotFoundError, match="folder must exist"), new_hdf5(tmp_path / "none" / "a.h5"):
        pass


def test_an_older_file_is_emptied(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    for count in (100_000, 10):
        with new_hdf5(file) as made:
            made["values"] = np.arange(count)
    assert file.stat().st_size < 10_000
    with h5py.File(file) as made:
        assert made["values"].size == 10
