"""Files that are not a trace, or a damaged one: each is refused in one sentence, none gives a wrong value."""

import re
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from session_scenes import many_records, record, refused, session_file, small_bone, writer  # noqa: F401

import burrlab

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


def blank(row, name, value):
    def change(file):
        now = file["ticks"][row]
        now[name] = value
        file["ticks"][row] = now

    return change


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
        (_replace("recorded", np.uint64(21)), ".*21 ticks are counted, and there is room for 20"),
        (blank(7, "index", 0), "damaged: the row of tick 47 holds something else"),
        (blank(3, "k", 0), "damaged: the row of tick 43 holds something else"),
        (lambda trace: trace["volume/density"].__setitem__((0, 0, 0), 3), "damaged: the bone has digest"),
        (_set("initial_digest", "0" * 32), ".*its volume is not the one that the session began with"),
        *((change, "") for change in (
            _set("burrs", 3), _set("burrs", "two"), _set("burrs", np.inf), _set("seed", "x"), _set("period_ms", "long"),
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
    for part, said in [(-500, "damaged: it was cut short"), *parts]:
        file.write_bytes(whole[:part])
        with pytest.raises(ValueError, match=rf"^{re.escape(str(file))} is {said}"):
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
