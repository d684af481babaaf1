"""Traces: recorded values come back to the bit, whatever ended the recording; other and damaged files are refused."""

import dataclasses
import re
import sys
import time
import zlib
from pathlib import Path
from unittest.mock import Mock

import h5py
import numpy as np
import pytest
from replica_scenes import soon
from session_scenes import (
    FakeReader,
    file_size_limit,
    make_records,
    many_records,  # noqa: F401
    new_writer,
    record,
    recorded,
    refused,
    session_file,  # noqa: F401
    small_bone,
    tools,
    writer,
)

import burrlab
import burrlab.session.recorder as trace_writer
from burrlab.cli import main
from burrlab.session.trace import BURR_DTYPE


def assert_holds(trace, records):
    assert len(trace) == len(records)
    for name, field in {"index": "index", "k": "k", "time_s": "time", "cpu_time_us": "cpu_time"}.items():
        np.testing.assert_array_equal(trace.array(name), records[field])
    columns = {
        "center_mm": "center", "radius_mm": "radius", "material": "material", "on": "on", "touching": "touching",
        "ambiguous": "ambiguous", "force_N": "force", "penetration_mm": "penetration", "removed_levels": "removed",
        "sent_force_N": "sent", "device_position_mm": "device_position",
        "device_velocity_mm_s": "device_velocity", "age_ms": "age", "orientation": "orientation", "buttons": "buttons",
    }  # fmt: skip
    assert set(columns) == set(BURR_DTYPE.names)
    for burr in range(trace.burrs):
        for name, field in columns.items():
            assert trace.array(name, burr).tobytes() == records["burr"][field][:, burr].tobytes()


def test_every_column_comes_back_to_the_bit(file, records):
    made = record(file, records[:1], records[1:700], records[700:], duration=1.5)  # of just these ticks
    assert (made.recorded, made.ended, made.complete, made.warning) == (1500, "stopped", True, "")
    trace = burrlab.load_trace(file)
    assert_holds(trace, records)
    assert (trace.complete, trace.ended) == (True, "stopped")


@pytest.mark.parametrize("burrs", [1, 2])
def test_nan_payloads_and_extremes_survive(file, burrs):
    records = make_records(small_bone(), 30, burrs=burrs)
    bits = np.arange(30, dtype=np.uint64) + np.uint64(0x7FF8000000001234)
    records["burr"]["age"][:, 0] = bits.view(np.float64)
    records["burr"]["removed"][:, 0] = np.iinfo(np.int64).max
    trace = recorded(file, records, burrs=burrs, seed=2**64 - 1)
    assert_holds(trace, records)
    assert (trace.seed, trace.burrs) == (2**64 - 1, burrs)


def test_the_header_comes_back(file):
    start = small_bone()
    wax = burrlab.Material(
        "wax", c_e=0.1, alpha=0.2, shape="power(1.5)", source="me", force_exponent=2, rate_exponent=0.5
    )
    before = time.time()
    made = new_writer(
        file, FakeReader(), start, [(burrlab.Burr(2.0), wax)],
        seed=11, period=0.25, scheme="cell", first_tick=99, devices=["hand"], source={"path": "ct.nrrd"},
        force_limit_N=5.0, coupling=None,
    )  # fmt: skip
    made.add_digest(99, start.digest())
    made.stop("the device is lost")
    trace = burrlab.load_trace(file)
    assert trace.tools == ((burrlab.Burr(2.0), wax),)
    assert (trace.seed, trace.period, trace.scheme, trace.first_tick) == (11, 0.25, "cell", 99)
    assert (trace.devices, trace.source, trace.note["force_limit_N"], trace.ended, trace.complete) == (
        ("hand",), '{"path": "ct.nrrd"}', 5.0, "the device is lost", True,
    )  # fmt: skip
    assert trace.digests == ((99, start.digest()),)
    assert trace.initial_digest == trace.bone().digest() == start.digest()
    np.testing.assert_array_equal(trace.bone().pristine, start.pristine)
    assert trace.provenance["burrlab"] == burrlab.__version__
    assert before <= trace.provenance["started_unix_s"] <= time.time()
    with h5py.File(file) as plain:
        assert plain.attrs["loop_rate_Hz"] == 4000.0
    assert (len(trace), trace.duration) == (0, 0)


def test_a_session_that_still_runs_is_read_and_plain_h5py_reads_it_too(file, records):
    reader = FakeReader(records[:600])
    made = writer(file, reader=reader)
    made.start()
    assert soon(lambda: made.recorded == 600)
    trace = burrlab.load_trace(file)
    assert_holds(trace, records[:600])
    assert (trace.ended, trace.complete) == ("", False)
    with h5py.File(file) as plain:
        rows = plain["ticks"][: plain["recorded"][()]]
        assert rows["force_z_N"].tobytes() == records["burr"]["force"][:600, 0, 2].tobytes()
    assert "still recorded" in repr(trace)
    reader.feed(records[600:])
    made.stop()
    assert_holds(burrlab.load_trace(file), records)
    with h5py.File(file) as plain:
        assert plain["ticks"].compression == "gzip"
    assert [p.name for p in file.parent.iterdir()] == [file.name]


def test_the_raw_file_takes_room_only_as_it_is_written(file, records):
    with (file.parent / "sparse").open("wb") as sparse:
        sparse.truncate(10_000_000)
    if (file.parent / "sparse").stat().st_blocks > 100:
        pytest.skip("this file system has no sparse files")
    made = writer(file, records)
    about = file.stat()
    assert about.st_size > 4 * 3600 * 1000 * 150
    assert about.st_blocks * 512 < 200_000
    made.stop()
    assert file.stat().st_size < 300_000


def test_a_compact_copy_that_fails_leaves_the_raw_file(file, records, monkeypatch):
    monkeypatch.setattr(
        trace_writer, "make_compact", Mock(side_effect=OSError(28, "No space left on device"))
    )
    assert "could not be compacted: No space left on device" in record(file, records).warning
    trace = burrlab.load_trace(file)
    assert_holds(trace, records)
    assert trace.complete


def test_a_digest_waits_for_its_ticks(file, records):
    start, end = small_bone().digest(), "0" * 32
    made = writer(file, records)
    made.add_digest(40, start)
    made.add_digest(1540, end)
    made.add_digest(1541, end)  # of a tick that never comes
    made.start()
    made.stop()
    assert burrlab.load_trace(file).digests == ((40, start), (1540, end))


def test_a_full_disk_ends_recording_at_a_tick_and_says_so_at_once(file, records):
    """A real limit (RLIMIT_FSIZE), which lets the last row be written in part."""
    told = []
    made = writer(file, records[:400], records[400:], on_end=told.append)
    with file_size_limit(made._places["ticks"] + 1000 * made._row_bytes + 17):
        made.start()
        made._thread.join(10)
    said = "recording ended before tick 1040: the file could not be written: File too large"
    assert told == [said]
    assert (made.ended, made.recorded, made.complete) == (said, 1000, False)
    for end in (lambda: None, made.stop):
        end()
        trace = burrlab.load_trace(file)
        assert_holds(trace, records[:1000])
        assert (trace.ended, trace.complete) == (said, False)
    assert burrlab.replay(trace).equal
    assert told == [said]


def test_a_count_that_cannot_be_written_does_not_count(file, records, monkeypatch):
    real = trace_writer._write

    def fails(descriptor, data, at):
        if len(data) == 8:
            raise OSError(5, "Input/output error")
        return real(descriptor, data, at)

    monkeypatch.setattr(trace_writer, "_write", fails)
    made = record(file, records)
    assert made.recorded == 0
    assert made.ended == "recording ended before tick 40: the file could not be written: Input/output error"
    assert len(burrlab.load_trace(file)) == 0


@pytest.mark.parametrize(
    ("reader", "options", "kept", "said"),
    [
        (lambda records: FakeReader(records[:300], lost_at_end=True), {}, 300,
         "before tick 340: the ring was overrun: the disk or the processor was too slow"),
        (lambda records: FakeReader(np.delete(records, 500), records[700:800]), {}, 500,
         "before tick 540: the record of the next tick is missing, tick 541 came"),
        (FakeReader, {"duration": 1.0}, 1000,
         "before tick 1040: the file has no room for more ticks: its duration is over"),
        (lambda _: Mock(take=Mock(side_effect=RuntimeError("the ring is gone"))), {}, 0, "before tick 40: recording failed: the ring is gone"),
    ],
)  # fmt: skip
def test_what_ends_recording(file, records, reader, options, kept, said):
    told = []
    made = writer(file, reader=reader(records), on_end=told.append, **options)
    made.start()
    made._thread.join(10)
    assert told == [made.ended] == [f"recording ended {said}"]
    made.stop()
    trace = burrlab.load_trace(file)
    assert_holds(trace, records[:kept])
    assert trace.ended == told[0]


def test_frames_and_columns(file, monkeypatch):
    pandas = pytest.importorskip("pandas")
    records = make_records(small_bone(), 200, burrs=2)
    trace = recorded(file, records, burrs=2)
    first, table = (trace.to_dataframe(burr) for burr in (0, 1))
    with h5py.File(file) as plain:
        raw = pandas.DataFrame(plain["ticks"][:]).set_index("index")
    second = table.drop(columns=["k", "time_s", "cpu_time_us"]).add_prefix("burr1_")
    pandas.testing.assert_frame_equal(raw, first.join(second))
    np.testing.assert_array_equal(table["sent_force_y_N"], records["burr"]["sent"][:, 1, 1])
    np.testing.assert_array_equal(
        table["device_velocity_z_mm_s"], records["burr"]["device_velocity"][:, 1, 2]
    )
    assert main(["export", str(file), "--out", str(file.with_suffix(".csv"))]) in (0, None)
    rows = np.genfromtxt(file.with_suffix(".csv"), delimiter=",", names=True)
    assert rows["index"].tolist() == np.repeat(trace.ticks["index"], 2).tolist()
    for burr in (0, 1):
        columns = trace.columns(burr)
        assert rows.dtype.names == ("burr", *columns)
        for name, values in columns.items():
            np.testing.assert_array_equal(rows[name][rows["burr"] == burr], values)
    refused(
        (lambda: trace.to_dataframe(2), "burr must be an index below 2, got 2"),
        (lambda: trace.array("force_N", -1), "burr must be an index below 2, got -1"),
        (lambda: trace.array("burr"), r"name must be one of index, k, .*, got 'burr'"),
        (lambda: trace.array("force_N").fill(0.0), "read-only"),
    )
    assert (trace.time()[-1], trace.duration) == (pytest.approx(trace.duration), records["k"].sum() / 1000.0)
    assert trace.duration is trace.duration, "summed over all ticks at each look"
    assert trace.initial_digest is trace.initial_digest, "hashed at each look"
    assert dataclasses.replace(trace, ticks=trace.ticks[:10]).duration < trace.duration
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="to_dataframe needs pandas: pip install"):
        trace.to_dataframe()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"limit": object()}, "note must be what JSON holds"),
        ({"limit": float("nan")}, "note must be what JSON holds"),
    ],
)
def test_wrong_parameters(file, change, said):
    given = {"tools": tools(), "seed": 1, **change}
    with pytest.raises(ValueError, match=said):
        new_writer(file, FakeReader(), small_bone(), **given)
    assert list(file.parent.iterdir()) == []


@pytest.mark.parametrize(
    ("theirs", "error", "said"),
    [(None, OSError, "killed here"), ("theirs", FileExistsError, "path must be a new file")],
)
def test_a_file_has_its_name_when_it_is_whole(file, monkeypatch, theirs, error, said):
    """None is left of one that was killed before; the trace of another session that took the name meanwhile stays."""
    create = trace_writer.create

    def slow(*args, **settings):
        places = create(*args, **settings)
        assert not file.exists()
        if theirs is None:
            raise OSError(5, "killed here")
        file.write_text(theirs)
        return places

    monkeypatch.setattr(trace_writer, "create", slow)
    with pytest.raises(error, match=said):
        writer(file)
    assert {path: path.read_text() for path in file.parent.iterdir()} == ({file: theirs} if theirs else {})


def test_without_hard_links(file, monkeypatch):
    monkeypatch.setattr(trace_writer.os, "link", Mock(side_effect=OSError(95, "Operation not supported")))
    writer(file).stop()
    assert burrlab.load_trace(file).complete


def test_a_recorder_is_for_one_new_file_that_can_be(file, records):
    """The refusals are one sentence; the older trace stays, and nothing else."""
    recorder = record(file, records)
    refused(
        (recorder.start, "recording must be started once: it has been started or stopped"),
        (lambda: writer(file), "path must be a new file", FileExistsError),
        (lambda: writer(file.parent / "nowhere" / "session.h5"), "folder must exist, got", OSError),
        (
            lambda: writer(file.with_name("long.h5"), duration=1e14),
            "could not be made|File too large",
            OSError,
        ),
    )
    assert_holds(burrlab.load_trace(file), records)
    assert list(file.parent.iterdir()) == [file]


# --- Files that are no trace, or a damaged one: each is refused in one sentence, none gives a wrong value ---


FLAT = Path(__file__).parents[1] / "golden/files/flat.burr"  # 60 ticks of two burrs
ROW, END = 32 + 2 * 192, 200  # bytes


@pytest.mark.parametrize(
    ("make", "error", "said"),
    [
        (lambda file: None, FileNotFoundError, None),
        (lambda file: file.write_bytes(b""), ValueError, "is not a burrlab trace: not an HDF5 file"),
        (lambda file: burrlab.save_bone(file, small_bone()), ValueError, r"is not a burrlab trace$"),
    ],
    ids=["missing", "empty", "a bone"],
)
def test_what_is_no_trace(file, make, error, said):
    make(file)
    with pytest.raises(error, match=said):
        burrlab.load_trace(file)


def blank(row, name, value=0):
    return lambda trace: trace["ticks"].__setitem__((row, name), value)


def _set(name, value):
    return lambda trace: trace.attrs.__setitem__(name, value)


def _replace(name, data):
    def change(trace):
        del trace[name]
        trace[name] = data

    return change


def test_a_byte_lost_in_a_compressed_row_is_an_error(file, records):
    record(file, records)
    with h5py.File(file) as plain:
        chunk = plain["ticks"].id.get_chunk_info(0)
    data = bytearray(file.read_bytes())
    for i in range(100):
        data[chunk.byte_offset + chunk.size // 2 + i] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(ValueError, match="is damaged"):
        burrlab.load_trace(file)


@pytest.mark.parametrize("duration", [0.001, 1.0, 3600.0])
def test_counts_lie_within_a_page_and_before_the_tables(file, duration):
    made = writer(file, duration=duration)
    at = made._places
    small = [at[name] for name in ("recorded", "digests_recorded", "ended", "complete")]
    assert max(small) < min(at["ticks"], at["digests"])
    assert all(place % 64 == 0 for place in [*small, at["ticks"], at["digests"]])
    made.stop()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_set("format_version", 5), "a burrlab trace of format 5, and this version reads up to 4"),
        (lambda trace: trace.__delitem__("ticks"), "damaged"),
        (lambda trace: trace.attrs.__delitem__("seed"), "damaged"),
        (_replace("recorded", np.uint64(21)), ".*ticks has room for 20 rows, and 21 are counted"),
        (_replace("recorded", np.uint64(19)), ".*ticks has room for 20 rows, and 19 are counted"),
        (blank(7, "index"), "damaged: the row of tick 47 holds something else"),
        (blank(3, "k"), "damaged: the row of tick 43 holds something else"),
        (blank(5, "touching", 255), "damaged: the row of tick 45 holds what no burr can do"),
        (blank(2, "center_x_mm", np.nan), "damaged: the row of tick 42 holds what no burr can do"),
        (blank(2, "removed_levels", -1), "damaged: the row of tick 42 holds what no burr can do"),
        (lambda trace: trace["volume/density"].__setitem__((0, 0, 0), 3), "damaged: the bone has digest"),
        (_set("initial_digest", "0" * 32), ".*its volume is not the one that the session began with"),
        *((change, "") for change in (
            _set("burrs", 3), _set("burrs", "two"), _set("burrs", np.inf), _set("seed", "x"), _set("period_ms", "long"), _set("period_ms", 0.0),
            _set("started_unix_s", [1.0, 2.0]),
            _set("first_tick", -1.5), _set("format_version", "new"), _set("initial_digest", [1, 2]),
            _replace("note", "{not JSON"), _replace("note", np.bytes_(b"\xff\xfe")), _replace("note", 5),
            _replace("ticks", 5), _replace("recorded", np.zeros(3)),
            _replace("volume/density", np.zeros(5, np.uint8)), _replace("volume/density", np.zeros((2, 2, 2))),
            lambda trace: trace.__delitem__("tools/0"), lambda trace: trace["tools/0"].attrs.__setitem__("shape", "odd"),
            lambda trace: trace["tools/0"].attrs.__setitem__("radius_mm", np.nan),
            lambda trace: trace["tools/0"].attrs.__setitem__("force_exponent", 0.5),
            lambda trace: trace["volume"].attrs.__setitem__("spacing_mm", [0.0, 1.0, 1.0]),
            lambda trace: trace["volume"].attrs.__setitem__("tick", "late"),
        )),
    ],
)  # fmt: skip
def test_content_that_no_session_wrote(file, records, change, said):
    """The file is refused in a sentence that names it."""
    record(file, records[:20])
    with h5py.File(file, "r+") as trace:
        change(trace)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(file))} is {said}"):
        burrlab.load_trace(file)


def test_cut_short(file, records):
    record(file, records[:200])
    whole = file.read_bytes()
    parts = [(int(part), "") for part in np.linspace(0, len(whole) - 1, 40)]
    for part, sentence in [(-500, "damaged: it was cut short"), *parts]:
        file.write_bytes(whole[:part])
        with pytest.raises(ValueError, match=rf"^{re.escape(str(file))} is {sentence}"):
            burrlab.load_trace(file)


@pytest.mark.parametrize("lost", [1, END, END + 1, END + ROW - 1, END + ROW, END + 60 * ROW])
def test_a_flat_file_of_a_killed_program(tmp_path, lost):
    """It is read up to its last whole row; what is left of its end is less than a row."""
    (file := tmp_path / "killed.burr").write_bytes(FLAT.read_bytes()[:-lost])
    trace, whole = burrlab.load_trace(file), burrlab.load_trace(FLAT)
    assert trace.ticks.tobytes() == whole.ticks[: 60 - max(lost - END + ROW - 1, 0) // ROW].tobytes()
    assert (trace.ended, trace.complete, trace.digests) == ("", False, ())


def test_a_flat_file_with_a_changed_byte(tmp_path):
    """It is refused; without the word "end" it is that of a killed program."""
    whole, file = bytearray(FLAT.read_bytes()), tmp_path / "changed.burr"
    end = len(whole) - END
    for at in [*range(0, end, 307), *range(end, len(whole))]:
        whole[at] ^= 1 << at % 8
        file.write_bytes(whole)
        if end <= at < end + 5:
            assert (len(burrlab.load_trace(file)), burrlab.load_trace(file).ended) == (60, "")
        else:
            with pytest.raises(ValueError, match=rf"^{re.escape(str(file))} is "):
                burrlab.load_trace(file)
        whole[at] ^= 1 << at % 8
        file.unlink()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((b"12 13 19 ", b"99999 99999 99999 "), "is damaged: its bone needs .* GB of memory"),
        ((b" 2 0.59999999999999998 ", b" 3 0.59999999999999998 "), "is damaged"),
        ((b" 2 0.59999999999999998 ", b" 2 nan "), "is damaged: radius must be positive and finite, got nan"),
        ((b'"made', b'"\xff'), "is damaged: 'utf-8' codec"),
        ((b"flat file 1 ", b"flat file 2 "), "is not a flat file of format 1, the newest that is known"),
    ],
)  # fmt: skip
def test_a_flat_header_that_no_program_wrote(tmp_path, words, said):
    """The checksum of the header is right."""
    line, rest = FLAT.read_bytes().replace(*words, 1).split(b"\n", 1)
    *_, version, size, _ = line.split()
    change = len(words[1]) - len(words[0]) if words[0] not in line and version == b"1" else 0
    head = rest[: int(size) + change]
    line = b"burrlab flat file %s %d %d" % (version, len(head), zlib.adler32(head))
    (file := tmp_path / "made.burr").write_bytes(line + b"\n" + rest)
    with pytest.raises(ValueError, match=said):
        burrlab.load_trace(file)


def test_a_flat_bone_is_no_trace(tmp_path):
    bone, trace = tmp_path / "bone.burr", tmp_path / "trace.burr"
    burrlab.save_bone(bone, small_bone())
    trace.write_bytes(FLAT.read_bytes())
    refused(
        (lambda: burrlab.load_trace(bone), "bone.burr is not a burrlab trace: it holds a bone alone"),
        (
            lambda: burrlab.save_bone(trace, small_bone()),
            "must be a new file or a burrlab bone",
            FileExistsError,
        ),
    )
