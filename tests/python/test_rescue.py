"""A bone that cannot be saved as asked at a session's end is saved elsewhere, in its exact state."""

import errno
import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from unittest.mock import DEFAULT, Mock

import h5py
import numpy as np
import pytest
from replica_scenes import published
from session_scenes import file_size_limit

import burrlab
from burrlab.anatomy import default_tissues, write_tissues
from burrlab.cli import main
from burrlab.cli.options import save_figure
from burrlab.common.figures import new_figure
from burrlab.common.files import kept_elsewhere
from burrlab.view.film import write_video

SESSION = ("session", "--device", "hand", "--duration", "0.2", "--voxel", "0.5", "--seed", "1")


@pytest.mark.parametrize(("after", "temporary"), [(1, "."), (2, "."), (9, "."), (9, "missing")])
def test_kept_beside_or_among_temporary_files_or_nowhere(
    after: int,
    temporary: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / temporary))
    path = str(tmp_path / "bone.h5")
    full = OSError(errno.ENOSPC, "No space left on device", path)  # for the first `after` files
    save = Mock(wraps=burrlab.save_bone, side_effect=[full] * after + [DEFAULT])
    monkeypatch.setattr("burrlab.cli.bone.save_bone", save)
    assert main([*SESSION, "--save", path]) == 3
    told, sentence = capsys.readouterr(), f"burrlab session: {path}: No space left on device"
    assert "200 ticks" in told.out, "the report is told all the same"
    if after == 9:
        assert told.err.endswith(f"{sentence}\n")
        assert list(tmp_path.iterdir()) == [], "nothing is left"
        return
    place = Path(told.err.split(f"{sentence}; the bone's exact state is kept as ")[1].strip())
    assert place == (tmp_path / "bone.h5.h5" if after == 1 else place.parent / "bone.h5")
    assert burrlab.load_bone(place)[1] == 200
    assert not Path(path).exists()


def test_what_stands_beside_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    older = tmp_path / "bone.h5.h5"
    older.write_text("older")
    place = kept_elsewhere(str(tmp_path / "bone.h5"), "bone.h5", lambda place: Path(place).write_text("new"))
    assert place is not None
    assert (older.read_text(), Path(place).read_text()) == ("older", "new")


def full_disk(trace: Path) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_result_over_a_file_in_a_folder_that_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "table.csv"
    path.write_text("older")
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    monkeypatch.setattr("burrlab.common.files.new_file", lambda file: pytest.fail("a new file in the folder"))
    WRITERS["table.csv"](path)
    assert burrlab.VelocityCurve.from_csv(path).source == "two runs"


def damage(trace: Path) -> None:
    with trace.open("r+b") as file:
        file.seek(1024)
        file.write(bytes(4096))


def damage_row(trace: Path) -> None:
    with h5py.File(trace) as file:
        place = file["ticks"].id.get_offset()
    with trace.open("r+b") as raw:
        raw.seek(place)
        raw.write(b"\xff" * 64)


@pytest.mark.parametrize(
    ("what", "sentence"),
    [
        (Path.unlink, "was deleted or moved"), (lambda trace: trace.rename(f"{trace}.mine"), "was deleted or moved"),
        (lambda trace: (trace.unlink(), trace.write_text("mine")), "was replaced"),
        (lambda trace: trace.write_text("mine"), "was overwritten"), (full_disk, "No space left on device"),
        (lambda trace: os.truncate(trace, 5000), "was cut short"), (damage, "cannot be read"),
        (damage_row, "the row of tick 0 holds something else"),
    ],
    ids=["deleted", "moved", "replaced", "overwritten", "full", "cut", "damaged", "a row damaged"],
)  # fmt: skip
def test_a_trace_that_is_not_whole_is_said_and_what_can_be_is_kept(
    what: Callable[[Path], object], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    trace, result, kept, written = tmp_path / "a.h5", tmp_path / "a.json", tmp_path / "a.h5.h5", []

    def meanwhile(file: int, data: bytes, at: int) -> int:
        written.append(len(data))
        if len(written) == 3 or (len(written) > 3 and what is full_disk):
            what(trace)
        return os.pwrite(file, data, at)

    monkeypatch.setattr("burrlab.session.recorder._write", meanwhile)
    assert main([*SESSION, "--record", str(trace), "--json", str(result)]) == 3
    told, recording = capsys.readouterr(), json.loads(result.read_text())["recording"]
    assert (sentence in recording["ended"], recording["complete"], "complete False" in told.out) == (
        True,
        False,
        True,
    )
    assert sentence in told.out
    assert sentence in told.err
    if sentence in ("was deleted or moved", "was replaced"):
        assert (recording["rescued"], len(burrlab.load_trace(kept))) == (str(kept), 200)
        assert burrlab.replay(burrlab.load_trace(kept)).equal
        assert sentence != "was replaced" or trace.read_text() == "mine"
    else:
        assert (recording["rescued"], burrlab.load_bone(kept)[1]) == ("", 200)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a file that is always full is of Linux")
@pytest.mark.parametrize("option", ["--json", "--plot"])
def test_a_result_that_cannot_be_written(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bone is kept, the report is told, and the message names the file."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    result, kept = tmp_path / "result.png", tmp_path / "bone.h5"
    result.symlink_to("/dev/full")
    assert main([*SESSION, option, str(result), "--save", str(kept)]) == 3
    told = capsys.readouterr()
    assert "200 ticks" in told.out
    said, place = told.err.rstrip("\n").rsplit(" is kept as ", 1)
    assert f"burrlab session: {result}: No space left on device; the " in said
    assert Path(place).stat().st_size > 1000
    assert burrlab.load_bone(kept)[1] == 200


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a file that is always full is of Linux")
def test_a_replica_keeps_its_bone_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    kept = tmp_path / "bone.h5"
    with published(60.0) as session:
        where = ["replica", f"127.0.0.1:{session.port}", "--duration", "0.5"]
        assert main([*where, "--json", "/dev/full", "--save", str(kept)]) == 3
    told = capsys.readouterr()
    assert told.out.startswith("ended (stopped): tick ")
    assert "burrlab replica: /dev/full: No space left on device; the result is kept as " in told.err
    assert burrlab.load_bone(kept)[0].shape == (20, 40, 40)


WRITERS: dict[str, Callable[[Path], object]] = {
    "table.csv": lambda path: burrlab.VelocityCurve([0.5, 4], [0.1, 0.2], source="two runs").to_csv(path),
    "run.json": lambda path: burrlab.descend(
        burrlab.Burr(2.0),
        burrlab.materials["bone"],
        2.0,
        voxel=0.5,
        seed=1,
        settings=burrlab.DescentSettings(max_duration=0.01),
    ).save(path),
    "tissues.csv": lambda path: write_tissues(path, default_tissues({1: "bone"})),
    "bone.h5": lambda path: burrlab.save_bone(path, burrlab.VoxelBone.block((1, 1, 1), 0.5)),
    "figure.png": lambda path: save_figure(new_figure().subplots(), str(path)),
    "film.gif": lambda path: write_video(path, [np.zeros((4, 4, 3), np.uint8)], fps=10),
    "slices": lambda path: burrlab.volume.write_dicom(
        path, burrlab.Volume(np.zeros((2, 4, 4), np.int16), (1, 1, 1), (0, 0, 0), np.eye(3), "made")
    ),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_what_was_there(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    path = tmp_path / name
    if name != "slices":  # a folder must be new
        WRITERS[name](path)
        path.chmod(0o600)
    before = [(place, place.read_bytes(), place.stat().st_mode) for place in tmp_path.iterdir()]
    said = f"File too large: '{path}" if name != "slices" else "Errno 5.*disk full"
    with file_size_limit(1), pytest.raises(OSError, match=said):
        WRITERS[name](path)
    assert [(place, place.read_bytes(), place.stat().st_mode) for place in tmp_path.iterdir()] == before
