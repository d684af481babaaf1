"""Targets of the fuzz test: every public reader, with seeds from writers and scenes of other tests."""

import contextlib
import json
import os
import re
import shutil
import socket
import struct
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
import wire
from anatomy_scenes import nerve_bone, straight, tool
from answer_scenes import TASKS, begun, protocol
from dicom_series import write_series
from drilled_scenes import MAP, drilled, greys, stack
from label_scenes import TABLE, label_file, volume
from replica_scenes import TOOL
from session_scenes import ended, make_records, record, session_of, small_bone
from test_analysis_files import HEAD, LEVELS, MATCH
from test_openigtlink import serve
from test_segments import FIELDS, layered, seg_nrrd

import burrlab
from burrlab import (
    Burr,
    DepthTrace,
    Descent,
    Fit,
    IgtlDevice,
    Indentation,
    Store,
    VelocityCurve,
    descend,
    fit,
    load_bone,
    load_trace,
    materials,
    read_labels,
    read_script,
    read_volume,
    replay,
    save_bone,
    session_metrics,
    synthetic_curve,
    synthetic_indentation,
    synthetic_trace,
    write_volume,
)
from burrlab.anatomy import Watch, anatomy_report, read_tissues, write_tissues
from burrlab.bone.recipe import LabelledRecipe, VolumeRecipe
from burrlab.common.study import key_of
from burrlab.psychophysics import Analysis, Protocol, analyse, read_folder, template
from burrlab.session.network import block_recipe, follow, make_bone
from burrlab.volume import load_drilled, read_stack, save_drilled

PACKAGE = str(Path(burrlab.__file__).parent)
BURR = Burr(3.0), materials["bone"]
VALUES = greys()[8:11, :5, :6]
Seed = Callable[[Path], object]


def _volume(name: str) -> object:
    return (read_labels if ".seg." in name else read_volume)(name)


def _dicom(name: str) -> object:
    alone = len(os.listdir()) == 1
    return read_volume(name if alone else ".", spacing=(0.25, 0.5, 0.75) if alone else None)


def _trace(name: str) -> object:
    trace = load_trace(name)
    return replay(trace), session_metrics(trace), trace._repr_html_(), trace.watch and anatomy_report(trace)


def _protocol(name: str) -> object:
    made = Protocol.read(name)
    return [made.side_car(made.subjects[0], task) for task in made.tasks]


def _experiment(name: str) -> object:
    made, found = Protocol.read(name), read_folder("data")
    made.resume("01", found[0].name)[0].close()
    return found, made.data.participants()


def _store(name: str) -> object:
    store = Store(name)
    return [store.get(key) for key in store._results]


def _hello(name: str) -> object:
    content = Path(name).read_bytes()
    digest = re.search(rb'"digest": "(\w{32})"', content) or [b"", b"0" * 32]
    hello = struct.pack(">IQQ32s", 2, 5, 0, digest[1]) + content
    with serve([wire.byte_string("burrlab_hello", hello)]) as port:
        return follow("127.0.0.1", port, timeout=0.1).stop()


def _device(name: str) -> object:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        device = IgtlDevice("127.0.0.1", listener.getsockname()[1])
        with listener.accept()[0] as peer, contextlib.suppress(ConnectionError):
            peer.sendall(Path(name).read_bytes())
            peer.shutdown(socket.SHUT_WR)
            peer.recv(1)
    device.stop()
    return device.counters


def _image(name: str, **options: Any) -> Seed:
    return lambda at: sitk.WriteImage(sitk.GetImageFromArray(VALUES), at / name, **options)


def _slice(packing: str) -> Seed:
    options = {"imageIO": "GDCMImageIO", "useCompression": True, "compressor": packing}

    def write(at: Path) -> None:
        write_series(at, np.arange(1024, dtype=np.int16).reshape(1, 32, 32))
        sitk.WriteImage(sitk.ReadImage(at / "slice000.dcm"), at / "slice000.dcm", **options)

    return write


def _stack(planes: np.ndarray) -> Seed:
    text = (
        "VOLUME v:\n  dimensions: {x: 0.009, y: 0.008, z: 0.007}\n  scale: 1.0\n  images:\n    path: slices\n"
    )
    text += f"    prefix: plane00\n    format: png\n    count: {len(planes)}\n"
    return lambda at: (stack(at / "slices", planes), (at / "in.yaml").write_text(text))


def _drilled(ending: str) -> Seed:
    def write(at: Path) -> None:
        write_volume(at.with_suffix(ending), volume())
        found = read_volume(at.with_suffix(ending))
        save_drilled(at / f"in{ending}", drilled(found), found, mapping=MAP)

    return write


def _watched(at: Path) -> None:
    bone, path = nerve_bone(), straight([(0, 0, 0.9), (0, 0, -0.5)], [0.0, 0.1])
    options = {"seed": 3, "duration": 0.1, "wall_clock": False, "watch": Watch(bone)}
    ended(session_of(bone, tool(), path, record=at / "in.h5", **options))


def _recipe(recipe: Mapping[str, Any]) -> Seed:
    def write(at: Path) -> None:
        write_volume(at / "ct.nrrd", volume())
        label_file(at / "labels.nii.gz", volume())
        with contextlib.chdir(at):
            told = {
                "seed": 7,
                "rate_Hz": 1e3,
                "scheme": "layer",
                "tools": [TOOL],
                "digest": make_bone(plain).digest(),
            }
        (at / "a.json").write_text(json.dumps({**told, "source": plain}))

    plain = json.loads(json.dumps(recipe).replace(f"{os.getcwd()}/", ""))
    return write


def _poses(version: int) -> Seed:
    poses = [wire.transform("burr", (k, 2.0, 3.0), version=version, timestamp=k) for k in (1.0, 2.0)]
    others = wire.sensor("burr", [1.0, 2.0]), wire.byte_string("x", b"text" * 30)
    return lambda at: (at / "in.igtl").write_bytes(b"".join([*poses, *others, poses[0]]))


#: Name: the reader, called with the first file of an input in its folder, and writers of seeds into a folder.
TARGETS: dict[str, tuple[Callable[[str], object], list[Seed]]] = {
    "nrrd": (_volume, [
        _image("in.nrrd"), _image("in.nrrd", useCompression=True), _image("in.nhdr"),
        lambda at: seg_nrrd(at / "in.seg.nrrd", np.random.default_rng(2).choice([0, 1, 4], (3, 4, 5)), FIELDS),
        lambda at: seg_nrrd(at / "in.seg.nrrd", *layered()),
    ]),
    "nifti": (_volume, [_image("in.nii"), _image("in.nii.gz"), _image("in.hdr")]),
    "meta": (_volume, [_image(name, useCompression=packed) for name in ("in.mha", "in.mhd") for packed in (False, True)]),
    "dicom": (_dicom, [lambda at: write_series(at, VALUES), _slice("JPEG"), _slice("JPEG2000"), _slice("JPEGLS")]),
    "stack": (read_stack, [
        _stack(VALUES.astype(np.uint8)), _stack(VALUES.astype(np.uint16)),
        _stack(np.array([(0, 0, 0, 0), (255, 249, 219, 255), (244, 214, 49, 255)], np.uint8)[VALUES % 3]),
    ]),
    "drilled": (lambda name: load_drilled(name).volume(), [_drilled(".nrrd"), _drilled(".nii.gz"), _drilled(".mha")]),
    "bone": (load_bone, [
        lambda at: save_bone(at / "in.h5", small_bone(), 50), lambda at: save_bone(at / "in.h5", nerve_bone()),
        lambda at: save_bone(at / "in.burr", nerve_bone(), source="a \"block\""),
    ]),
    "trace": (_trace, [
        lambda at: record(at / "in.h5", make_records(small_bone(), 40, first=40), duration=0.1), _watched,
        lambda at: shutil.copy(Path(__file__).parents[1] / "golden/files/flat.burr", at / "in.burr"),
    ]),
    "curve": (VelocityCurve.from_csv, [
        lambda at: synthetic_curve(*BURR, [0.8, 1.4, 2.0], seed=1).to_csv(at / "in.csv"),
    ]),
    "foreign": (partial(VelocityCurve.from_csv, columns={"force": "F [N]", "velocity": "v"}, unit="um/s", decimal=","), [
        lambda at: (at / "in.csv").write_text("Lab 3\n#a: b\nF [N];v;by\n;um/s;\n0,5;1.078,5;A\n1;498;\"B\nC\"\n"),
    ]),
    "indentation": (Indentation.from_csv, [
        lambda at: synthetic_indentation(*BURR, [0.1, 0.2], seed=1).to_csv(at / "in.csv"),
    ]),
    "depth": (DepthTrace.from_csv, [
        lambda at: synthetic_trace(*BURR, 2.0, sample_ms=10, seed=1).to_csv(at / "in.csv"),
    ]),
    "tissues": (read_tissues, [lambda at: write_tissues(at / "in.csv", TABLE)]),
    "script": (read_script, [lambda at: (at / "in.csv").write_text("# way\ntime_s,x_mm,y_mm,z_mm,on\n0,1,2,3,1\n1,2,3,4,0\n")]),
    "protocol": (_protocol, [
        lambda at: protocol(at, template()), lambda at: protocol(at, HEAD.format(more="", subjects=2) + MATCH + LEVELS),
    ]),
    "experiment": (_experiment, [lambda at, task=task: begun(at, task, 4) for task in TASKS]),
    "analysis": (Analysis.from_json, [lambda at: analyse(begun(at.parents[1], count=10)[0]).to_json(at / "in.json")]),
    "fit": (Fit.from_json, [
        lambda at: fit(synthetic_curve(*BURR, [0.8, 1.4, 2.0], seed=1), BURR[0]).to_json(at / "in.json"),
    ]),
    "descent": (Descent.load, [lambda at: descend(*BURR, 1.0, voxel=0.7, seed=1).save(at / "in.json")]),
    "store": (_store, [
        lambda at: Store(at / "in.jsonl").add(key_of(round, 1.5), {"a": (0.1, float("nan")), "b": np.arange(3.0)}),
    ]),
    "hello": (_hello, [_recipe(block_recipe((4, 4, 2), 0.2)), _recipe(LabelledRecipe("labels.nii.gz", TABLE).plain()), _recipe({
        "kind": "volume block", "volume": VolumeRecipe("ct.nrrd", MAP).plain(), "size_mm": [2, 2, 1], "voxel_mm": 0.2,
        "entry_mm": [6, -11.4, 11], "axis": [0, 1, 0],
    })]),
    "device": (_device, [_poses(1), _poses(2)]),
}  # fmt: skip
