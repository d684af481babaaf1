"""Small files that claim or unpack far too much, and damaged ones: one sentence, little memory and time."""

import gzip
import json
import os
import re
import struct
import subprocess
import sys
import zlib
from functools import cache

import h5py
import numpy as np
import pytest
from session_scenes import make_records, record, refused, small_bone
from volume_scenes import a_volume

from burrlab import Volume, VoxelBone, load_bone, load_trace, read_volume, replay, save_bone, write_volume
from burrlab.common.check import available_memory, shown
from burrlab.common.files import attributes
from burrlab.volume import write_dicom

resource = pytest.importorskip("resource", reason="limits of a process are POSIX")
#: Evaluates expressions, each in a fork with limits of 10 s of CPU and 2 GB more; prints results and memory [MB].
CHILD = """
import json, os, resource, signal, sys
import h5py, numpy as np, burrlab, burrlab.common.check, burrlab.bone.slices
from burrlab.anatomy import temporal_bone
for name in ("SimpleITK", "pydicom"):  # else what they take themselves counts as reading
    try:
        __import__(name)
    except ImportError:
        pass
if sys.argv[1] == "poor":
    burrlab.common.check.available_memory = lambda: 5e8
for line in sys.stdin:
    read, write = os.pipe()
    if not (child := os.fork()):
        size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize() + (2 << 30)
        resource.setrlimit(resource.RLIMIT_AS, (size, size))
        resource.setrlimit(resource.RLIMIT_CPU, (10, 10))
        signal.alarm(120)
        peaks = [resource.getrusage(resource.RUSAGE_SELF).ru_maxrss]
        try:
            found = repr(eval(line))
        except BaseException as error:
            found = f"{type(error).__name__}: {error}"
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
        os.write(write, json.dumps([found[:1000], (peaks[1] - peaks[0]) / 1e3]).encode())
        os._exit(0)
    os.close(write)
    print(os.read(read, 2000).decode() or '["killed", 0]')
    os.waitpid(child, 0)
"""


def evaluated(*expressions, how=""):
    """Result of each expression in a process of its own, and the memory it takes [MB]."""
    done = subprocess.run(
        [sys.executable, "-c", CHILD, how], input="\n".join(expressions), capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(found) == len(expressions), done.stderr
    return found


@cache
def zeros(bits):
    """200 MB of zeros as a gzip or zlib stream."""
    packer = zlib.compressobj(9, zlib.DEFLATED, bits)
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(200)) + packer.flush()


def nrrd(sizes, content, dimension=3):
    head = f"NRRD0004\ntype: int16\nendian: little\nencoding: gzip\ndimension: {dimension}\nsizes: {sizes}\nspacings: 1 1 1\n\n"
    return head.encode() + content


def meta(sizes, content, dimension=3, file="LOCAL"):
    return (
        f"NDims = {dimension}\nDimSize = {sizes}\nElementSpacing = 1 1 1\nElementType = "
        f"MET_SHORT\nCompressedData = True\nCompressedDataSize = {len(content)}\nElementDataFile = {file}\n"
    ).encode() + content


def nifti(*sizes, slope=0.0):
    head = bytearray(352)
    for place, kind, *values in (
        (0, "i", 348), (40, "8h", 3, *sizes, 1, 1, 1, 1), (70, "2h", 4, 16), (76, "8f", *[1.0] * 8), (108, "2f", 352.0, slope),
    ):  # fmt: skip
        struct.pack_into(f"<{kind}", head, place, *values)
    return bytes(head[:344]) + b"n+1\0" + bytes(4)


def laughs(first, each):
    lines = [
        f"{b}: &{b} {each.format(','.join([f'*{a}'] * 9))}"
        for a, b in zip("abcdefgh", "bcdefghi", strict=True)
    ]
    return "\n".join([f"a: &a {first}", *lines, "VOLUME v: *i"]).encode()


def dicom(path, side, syntax, content):
    """Writes a slice of 8 bits with encapsulated pixels, which have no length."""
    pydicom = pytest.importorskip("pydicom", reason="makes the slice, extra `dev`")
    from dicom_series import write_slice

    write_slice(path, np.zeros((4, 5)), (0, 0, 0), series="1.2", BitsAllocated=8, BitsStored=8, HighBit=7)
    part = pydicom.dcmread(path)
    part.Rows = part.Columns = side
    part.PixelData = pydicom.encaps.encapsulate([content])
    part["PixelData"].VR, part["PixelData"].is_undefined_length = "OB", True
    part.file_meta.TransferSyntaxUID = f"1.2.840.10008.1.2.{syntax}"
    part.save_as(path)


def bone(path, side):
    """Writes a bone with one chunk that unpacks to 200 MB; the other chunks are absent."""
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        file.attrs.update({"format": "burrlab bone", "format_version": 1})
        table = file.create_dataset("density", (side,) * 3, "u1", chunks=(64,) * 3, compression="gzip")
        table.id.write_direct_chunk((0, 0, 0), zeros(15))


def trace(path):
    """Writes a trace whose ticks are absent."""
    record(path, make_records(small_bone(), 20, first=40))
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        kind = file["ticks"].dtype
        del file["ticks"]
        file.create_dataset("ticks", (20_000_000,), kind, chunks=(4096,), compression="gzip", shuffle=True)
        file["recorded"][()] = 20_000_000


READ, BONE = "burrlab.read_volume({!r})", "burrlab.load_bone({!r})"
SLICE, STACK = (
    "burrlab.read_volume({!r}, spacing=(0.25, 0.5, 1))",
    "burrlab.bone.slices.read_stack({!r}, spacing=1)",
)
PNG = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR" + struct.pack(">2I5B", 16000, 5000, 16, 0, 0, 0, 0) + bytes(4)
FAR_MORE = "the compressed data must hold 128 bytes, as the header says, got far more"
BOMBS = [
    ("a.nrrd", nrrd("30000 30000 30000", gzip.compress(bytes(128))), READ, "bytes cannot hold"),
    ("a.nrrd", nrrd("900 900 900", gzip.compress(bytes(99)) + bytes(1 << 21)), READ,
     "needs 1.46 GB of memory, and 0.5 GB are"),
    ("a.nrrd", nrrd("4 4 4", b"", "9" * 20), READ, "contradicts its dimension 99999999999999999999"),
    ("a.nrrd", nrrd("4 4 4", b"", "9" * 9), READ, "contradicts its dimension 999999999"),
    ("a.nii.gz", lambda path: path.write_bytes(gzip.compress(nifti(4, 4, 4)) + zeros(31)), READ, FAR_MORE.replace("128", "480")),
    ("a.nii.gz", gzip.compress(nifti(30000, 30000, 30000)), READ, "bytes cannot hold"),
    ("a.nrrd", lambda path: path.write_bytes(nrrd("4 4 4", zeros(31))), READ, FAR_MORE), ("a.mha", lambda path: path.write_bytes(meta("4 4 4", zeros(15))), READ, FAR_MORE),
    *[("a.mha", meta("4 4 4", b"", n), READ,
        f"NDims .* must be the 3 numbers of DimSize, at most 10, got '{n}'")
      for n in (-1, 10000, 2147483648, 10**19)],
    ("a.mha", meta(" ".join(["1"] * 30000), b"", 30000), READ, "NDims .* at most 10, got '30000'"),
    ("a.mha", meta("4 4 4", b"", file="%099999999d 1 9 1"), READ, "the file of its values, .* is not there"),
    ("a.dcm", lambda path: dicom(path, 65535, "5", b"\x81\0"), SLICE, "needs 8.59 GB of memory"),
    ("a.dcm", lambda path: dicom(path, 64, "4.90", b"\xff\x4f\xff\x51\0\x29\0\0" + struct.pack(">2I", 40000, 40000)), SLICE,
     "cannot be read as a DICOM image|the pixel data of the slice is damaged|compressed pixels must be of "
     "the header's size, got 1600000000"),
    ("slice1.png", PNG, STACK, "bytes cannot hold"),
    ("a.yaml", laughs("[x,x,x,x,x,x,x,x,x]", "[{}]"), STACK.replace(", spacing=1", ""),
     "VOLUME v must have dimensions and images, got "),
    ("a.yaml", laughs("{x: 1}", "{{<<: [{}]}}"), STACK.replace(", spacing=1", ""),
     # PyYAML 6.0.4 merges each pair once, so the mapping stays small.
     "a mapping must have at most 300000 keys|images must be there"),
    *[(name, lambda path: (path.touch(), os.truncate(path, 200_000_000)), f"burrlab.{reader}({{!r}})",
       f"{name}: the file needs 1 GB of memory, and 0.5 GB are")
      for name, reader in (("a.csv", "VelocityCurve.from_csv"), ("a.json", "Fit.from_json"), ("a.vrpn", "read_vrpn_log"))],
    ("a.h5", lambda path: bone(path, 2000), BONE, "cannot hold 8000000000"),
    ("a.h5", lambda path: bone(path, 64), BONE, "must have chunks of 262144 bytes, got 262145 or more"),
    ("a.h5", trace, "burrlab.load_trace({!r})", "cannot hold 4400000000"),
]  # fmt: skip


def test_bombs(tmp_path):
    """Small files that unpack to 200 MB or terabytes, and headers that make a library end the process."""
    expressions = []
    for k, (name, content, reader, _) in enumerate(BOMBS):
        path = tmp_path / f"{k}" / name
        path.parent.mkdir()
        path.write_bytes(content) if isinstance(content, bytes) else content(path)
        expressions.append(reader.format(str(path.parent if path.suffix == ".png" else path)))
    for (_, _, _, said), (found, peak) in zip(BOMBS, evaluated(*expressions, how="poor"), strict=True):
        assert re.match(rf"ValueError: {re.escape(str(tmp_path))}.*({said})", found), found
        assert (peak < 100, len(found) < 600) == (True, True), (said, peak)


def test_more_voxels_than_memory():
    calls = [
        "burrlab.VoxelBone.block((300, 300, 300), 0.1)",
        "burrlab.VoxelBone(np.broadcast_to(np.uint8(1), (3000,) * 3), 0.1)",
        "burrlab.Volume(np.zeros((100,) * 3), (1,) * 3, (0,) * 3, np.eye(3), 'v').resample(0.175)",
        "burrlab.half_space(burrlab.Burr(3.0), 0.01)",
        "temporal_bone(0.07, seed=1)",
    ]
    for call, (found, peak) in zip(calls, evaluated(*calls, how="poor"), strict=True):
        assert re.match(r"ValueError: .*voxels needs \S+ GB of memory, and 0.5 GB are there", found), (
            call,
            found,
        )
        assert peak < 60
    (found, _), _ = evaluated("burrlab.VoxelBone.block((100, 100, 100), 0.1, level=0).shape", "1", how="poor")
    assert found == "(1000, 1000, 1000)"
    assert 1e8 < available_memory() < 1e14


def test_what_reading_takes(tmp_path):
    """Reading takes at most three times the memory of the array, plus a margin."""
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    values = np.random.default_rng(1).integers(0, 900, (100, 320, 320)).astype(np.int16)  # 20 MB
    volume = Volume(values, (1, 1, 1), (0, 0, 0), np.eye(3), "made")
    for name in ("a.nrrd", "a.nii.gz", "a.mha"):
        write_volume(tmp_path / name, volume)
    write_dicom(tmp_path / "dicom", volume)
    head = nrrd("320 320 100", b"").replace(b"gzip", b"raw").replace(b"little", b"big")
    (tmp_path / "big.nrrd").write_bytes(head + values.astype(">i2").tobytes())
    (tmp_path / "scaled.nii").write_bytes(nifti(320, 320, 100, slope=0.5) + values.tobytes())
    save_bone(tmp_path / "a.h5", VoxelBone(values.astype(np.uint8), 0.1))
    paths = sorted(tmp_path.iterdir())
    calls = [(BONE if path.suffix == ".h5" else READ).format(str(path)) for path in paths]
    for path, (found, peak) in zip(paths, evaluated(*calls), strict=True):
        assert found.startswith(("Volume", "(VoxelBone")), found
        size = values.size / 1e6 * {".h5": 1, ".nii": 4}.get(path.suffix, 2)
        # Measured: 10 MB above at most, and 10 MB vary by chance.
        assert peak < 3 * size + 40, (path, peak, size)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A bone and a trace, in the present format and in that of earlier versions."""
    folder = tmp_path_factory.mktemp("files")
    save_bone(folder / "bone.h5", small_bone(), 5)
    record(folder / "trace.h5", make_records(small_bone(), 30, first=40))
    for name in ("bone", "trace"):
        with h5py.File(folder / f"{name}.h5") as file, h5py.File(folder / f"old_{name}.h5", "w") as old:

            def copy(name, item, old=old):
                if isinstance(item, h5py.Dataset):
                    value = item[()].decode() if name == "note" else item[()]
                    options = {
                        "chunks": item.chunks,
                        "compression": item.compression,
                        "shuffle": item.shuffle,
                    }
                    old.create_dataset(name, data=value, **(options if item.chunks else {}))
                else:
                    old.require_group(name)
                old[name].attrs.update(attributes(item))

            old.attrs.update(attributes(file))
            file.visititems(copy)
    return folder


def test_files_of_earlier_versions(files):
    bones = [load_bone(files / f"{old}bone.h5") for old in ("", "old_")]
    assert (bones[0][0].digest(), bones[1][1]) == (bones[1][0].digest(), 5)
    trace, old = (load_trace(files / f"{old}trace.h5") for old in ("", "old_"))
    assert (old.ticks.tobytes(), old.note, old.provenance, old.tools, replay(old).equal) == (
        trace.ticks.tobytes(), trace.note, trace.provenance, trace.tools, True,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "step"),
    [("bone", 160), ("trace", 480), *(pytest.param(*each, marks=pytest.mark.slow) for each in (("bone", 32), ("trace", 96)))],
)  # fmt: skip
def test_zeros_anywhere_do_not_hang(files, name, step):
    """Metadata and streams have checksums: zeros are reported as damage, or have no effect."""
    path, damaged = files / f"{name}.h5", files / f"damaged_{name}.h5"
    content = path.read_bytes()
    assert content[8] == 3
    assert not re.search(b"TREE|SNOD|HEAP|GCOL", content)  # structures without checksums
    calls = [
        f"open({str(damaged)!r}, 'wb').write({str(path)!r} and open({str(path)!r}, 'rb').read()[:{at}] + "
        f"bytes(32) + open({str(path)!r}, 'rb').read()[{at + 32}:]) and burrlab.load_{name}({str(damaged)!r})"
        for at in range(0, len(content) - 32, step)
    ]
    for found, _ in evaluated(*calls):
        assert re.match(
            rf"ValueError: {re.escape(str(damaged))} is (not|damaged)|\(VoxelBone|Trace\(30", found
        )


def test_old_files_that_hang_the_library(files):
    content = bytearray((files / "old_bone.h5").read_bytes())
    at = content.index(b"GCOL") + 16
    content[at : at + 200] = bytes(200)
    (files / "hangs.h5").write_bytes(content)
    ((found, _),) = evaluated(BONE.format(str(files / "hangs.h5")))
    assert found.endswith("hangs.h5 is damaged: the HDF5 library hangs or crashes reading it")


def test_texts_of_any_length(tmp_path):
    text = "ä" * 100_000 + "\udcff"
    save_bone(tmp_path / "a.h5", small_bone(), source=text)
    with h5py.File(tmp_path / "a.h5") as file:
        assert attributes(file)["source"] == text


def test_refusals_are_short():
    deep = []
    for _ in range(40):
        deep = [deep] * 9
    assert len(shown(deep)) < 210
    assert (shown("x" * 10**6)[:5], shown({"a": 1}), shown(None)) == ("'xxxx", "{'a': 1}", "None")


@pytest.mark.parametrize("encoding", ["text", "hex"])
def test_values_in_several_files(tmp_path, encoding):
    """Files in a list or a pattern, with values after lines and bytes that are skipped."""
    volume, head = (
        a_volume(),
        "NRRD0004\ntype: int16\nendian: big\ndimension: 3\nsizes: 5 4 3\nspacings: 1 1 1\n",
    )
    for k, plane in enumerate(volume.values):
        content = plane.astype(">i2").tobytes()
        (tmp_path / f"ä{k}.raw").write_bytes(b"xyz" + content)
        text = " ".join(map(str, plane.ravel())) if encoding == "text" else content.hex()
        (tmp_path / f"b{k}.txt").write_text(f"a line\n{text}")
    listed = "ä0.raw\nä1.raw\nä2.raw\n"
    texts = {
        "a.nhdr": f"{head}encoding: raw\nbyte skip: 3\ndata file: LIST\n{listed}",
        "b.nhdr": f"{head}encoding: raw\nbyte skip: -1\ndata file: ä%d.raw 0 2 1\n",
        "c.nhdr": f"{head}encoding: {encoding}\nline skip: 1\ndata file: b%d.txt 0 2 1\n",
        "d.mhd": "NDims = 3\nDimSize = 5 4 3\nElementSpacing = 1 1 1\nElementType = "
                 "MET_SHORT\nBinaryDataByteOrderMSB = True\n"
        f"HeaderSize = 3\nElementDataFile = LIST\n{listed}",
    }  # fmt: skip
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        np.testing.assert_array_equal(read_volume(tmp_path / name).values, volume.values)
    for words in (["40000"] + 59 * ["1"], 61 * ["1"]):
        (tmp_path / "e.nrrd").write_text(f"{head}encoding: text\n\n{' '.join(words)}")
        refused((lambda: read_volume(tmp_path / "e.nrrd"), "or not the numbers of the header"))
