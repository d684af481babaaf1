"""One of each file that burrlab writes or reads, a few kB each; `files/` has those of an earlier version."""

import contextlib
import io
import shutil
from pathlib import Path

import numpy as np
from PIL import Image

import burrlab
from burrlab.anatomy import Watch, default_tissues
from burrlab.cli import main
from burrlab.volume import save_drilled, write_dicom

FILES = Path(__file__).parent / "files"
BURR, BONE = burrlab.Burr(3.0), burrlab.materials["bone"]


def run(*arguments: object) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of a command."""
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        try:
            status = main([str(a) for a in arguments])
        except SystemExit as ended:
            status = int(ended.code or 0)
    return status, out.getvalue(), error.getvalue()


def curve() -> burrlab.VelocityCurve:
    return burrlab.synthetic_curve(BURR, BONE, np.linspace(0.4, 2.6, 10), repeats=3, scatter=0.08, seed=2004)


def make_files(folder: Path) -> None:
    """One of each file that this version writes, a few kB each."""
    rng = np.random.default_rng(1)
    labels = np.ones((12, 20, 20), np.uint8)
    labels[:, 8:11], labels[9:] = 4, 0
    grey = np.where(labels > 0, 800 + rng.integers(0, 400, labels.shape), -1000).astype(np.int16)
    grid = (0.4, 0.4, 0.4), (5.0, -6.0, 7.0), np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    volume, mapping = burrlab.Volume(grey, *grid, "made"), burrlab.OccupancyMap.two_point(0, 1000)
    burrlab.write_volume(
        folder / "labels.nrrd", burrlab.LabelVolume(labels, *grid, "made", {1: "bone", 4: "facial nerve"})
    )
    bone = volume.to_bone(mapping)
    bone.set_tissues(
        default_tissues(["air", "bone", "facial nerve"]),
        np.select([labels == 1, labels == 4], [1, 2], 0).astype(np.uint8),
    )
    for ending in ("nrrd", "nii.gz", "mha", "nii"):
        burrlab.write_volume(folder / f"grey.{ending}", volume)
    top = np.array(bone.origin) + 0.4 * np.array([9.5, 9.5, 8.5])
    device = burrlab.ScriptedDevice(
        [0.0, 0.3, 1.0], [top + (0, 0, 3.5), top + (0, 0, 2.7), top + (0.5, 0.5, 2.0)]
    )
    with burrlab.Session(
        bone,
        (BURR, BONE),
        device,
        seed=7,
        duration=1.0,
        clock=burrlab.Clock(wall_clock=False),
        record=folder / "trace.h5",
        watch=Watch(bone),
    ) as session:
        session.wait()
    drilled, tick = session.snapshot()
    burrlab.save_bone(folder / "bone.h5", drilled, tick)
    for ending in ("nrrd", "nii.gz", "mha"):
        save_drilled(folder / f"drilled.{ending}", drilled, volume, mapping=mapping, tick=tick)
    write_dicom(folder / "grey_dicom", volume)
    with contextlib.chdir(folder):  # the pair keeps the file's name
        like = burrlab.read_volume("grey_dicom")
        again = like.to_bone(mapping)
        again.restore(drilled.density)
        save_drilled("drilled_dicom", again, like, mapping=mapping, tick=tick)
    _others(folder, grey, labels)
    data = curve()
    data.to_csv(folder / "curve.csv")
    burrlab.fit(data, BURR).to_json(folder / "fit.json")
    burrlab.descend(BURR, BONE, 1.0, voxel=0.3, seed=1).save(folder / "descent.npz")
    burrlab.force_sweep(BURR, BONE, [0.8, 1.2], repeats=2, voxel=0.3, seed=4, store=folder / "store.jsonl")
    if folder != FILES:
        shutil.copy(FILES / "experiment.toml", folder)
    with contextlib.chdir(folder):
        assert run("experiment", "run", "experiment.toml", "--simulated", "--all", "--fast")[0] == 0


def _others(folder: Path, grey: np.ndarray, labels: np.ndarray) -> None:
    """Files that are only read: headers with separate values, and slices as of volumetric_drilling."""
    (folder / "grey.raw").write_bytes(grey.tobytes())
    sizes = " ".join(str(n) for n in grey.shape[::-1])
    (folder / "grey.nhdr").write_text(
        f"NRRD0004\ntype: int16\nendian: little\nencoding: raw\ndimension: 3\nsizes: {sizes}\nspacings: 0.4 "
        "0.4 0.4\ndata file: grey.raw\n"
    )
    (folder / "grey.mhd").write_text(
        f"NDims = 3\nDimSize = {sizes}\nElementSpacing = 0.4 0.4 0.4\nElementType = "
        "MET_SHORT\nElementDataFile = grey.raw\n"
    )
    content = bytearray((folder / "grey.nii").read_bytes())
    content[108:112], content[344:348] = np.float32(0).tobytes(), b"ni1\0"
    (folder / "grey.hdr").write_bytes(content[:348])
    (folder / "grey.img").write_bytes(content[352:])
    (folder / "slices").mkdir()
    colours = np.array(
        [(0, 0, 0, 0), (255, 249, 219, 255), *[(0, 0, 0, 0)] * 2, (244, 214, 49, 255)], np.uint8
    )
    for k, plane in enumerate(colours[labels]):
        Image.fromarray(plane.swapaxes(0, 1)).save(folder / f"slices/plane00{k:03d}.png")
    (folder / "slices.yaml").write_text(
        "VOLUME v:\n  dimensions: {x: 0.008, y: 0.008, z: 0.0048}\n  images: {path: slices, prefix: plane00, "
        "format: png}\n"
    )
