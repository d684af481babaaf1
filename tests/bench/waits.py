"""Where a researcher waits: CPU time of each wait beside that of a plain tool, in turns in one run. Of a first
text it is the time until a terminal shows it.

The bone is the phantom on 512^3 voxels, with 15 labels. It is made once in the folder and serves again.
"""

import os
import pty
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from native import Burring, Core, Native
from PIL import Image

from burrlab import Burr, Clock, LabelVolume, ScriptedDevice, Session, Volume, materials, write_volume
from burrlab.anatomy import temporal_bone
from burrlab.bone.recipe import usual_recipe
from burrlab.bone.tissues import VOLUMETRIC_DRILLING

SIDE, VOXEL = 512, 0.1  # voxels along an edge; [mm]
#: The phantom's tissues by number, cut into the simulator's structures along an axis (z, y, x).
PARTS = {
    3: (0, ["Facial_Nerve", "Chorda_Tympani", "Cochlear_Nerve"]),
    4: (0, ["Sinus_+_Dura"]),
    5: (1, ["Sinus_+_Dura", "ICA"]),
    6: (2, ["IAC", "Bony_Labyrinth", "Superior_Vestibular_Nerve", "Inferior_Vestibular_Nerve",
            "Vestibular_Aqueduct"]),
    7: (1, ["Malleus", "Incus", "Stapes"]),
}  # fmt: skip


class Wait(NamedTuple):
    """A program that somebody waits for, and a plain one for the same input; both as Python."""

    name: str
    program: str
    plain_name: str
    plain: str


_WAY = "--entry=-7.6,9.5,-3.5 --axis 0.918,-0.147,0.369 --force 1 --seed 1"
_COMMAND = "from burrlab.cli import main; assert not main({!r}.split())"
_LABELS = """
import burrlab
from burrlab.bone.recipe import usual_recipe
bone = usual_recipe("labels.seg.nrrd", burrlab.materials["bone"], {}).bone()
"""
_KEEPING = "import os; os.environ['BURRLAB_CACHE'] = 'kept'"
_NRRD = """
import nrrd
nrrd.read("{}.nrrd")
"""
_FIT = """
import burrlab
burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
curve = burrlab.force_sweep(burr, bone, [0.4, 0.6, 0.8, 1.2, 1.6, 2.0], voxel=0.1, repeats={}, seed=1)
"""
_COVERAGE = """
import numpy as np, burrlab
from burrlab.planning.coverage import ExperimentPlan, coverage_study
forces = np.linspace(0.3, 2.6, 10)
plan = ExperimentPlan([(3.0, forces.tolist(), 3)])
"""
_EXPERIMENT = (
    "import sys; sys.argv[:] = 'burrlab experiment run test.toml --subject 1'.split(); import burrlab.cli"
)
WAITS = (
    Wait(
        "descend --labels, 512 PNG", _COMMAND.format(f"descend --labels stack.yaml {_WAY}"),
        "the images decoded by Pillow",
        "import glob, numpy, PIL.Image; [numpy.array(PIL.Image.open(p)) for p in sorted(glob.glob('png/*'))]",
    ),
    Wait("labels of an NRRD into bone", _LABELS, "the file read by pynrrd", _NRRD.format("labels.seg")),
    Wait("the same, started again", _KEEPING + _LABELS, "the first start", _LABELS),
    Wait(
        "a watch of 15 structures", _LABELS + """
import numpy
from burrlab.anatomy import Watch
Watch(bone, structures=[bone.tissues[i].name for i in numpy.unique(bone.tissue_numbers)[1:].tolist()])""",
        "bone, and SciPy's distances of its voxels", _LABELS + """
from scipy.ndimage import distance_transform_edt
distance_transform_edt(bone.tissue_numbers[::4, ::4, ::4] != 1)""",
    ),
    Wait(
        "--voxel 0.05 on a CT", _COMMAND.format(
            f"descend --volume grey.nrrd --map=-1000:1040 --voxel 0.05 {_WAY}"),
        "the file read by pynrrd", _NRRD.format("grey"),
    ),
    Wait(
        "view --png of a trace", _COMMAND.format("view ear.h5 --png ear.png"),
        "VTK's surface of the bone", """
import burrlab
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D
bone = burrlab.load_trace("ear.h5").bone()
image = vtkImageData()
image.SetDimensions(bone.shape[::-1])
levels = bone.density
image.GetPointData().SetScalars(numpy_to_vtk(levels.ravel()))
edges = vtkFlyingEdges3D()
edges.SetInputData(image)
edges.SetValue(0, 127.5)
edges.Update()""",
    ),
    Wait("first text of an experiment", _EXPERIMENT, "Python's own", "print(1, flush=True)"),
    Wait(
        "voxel fit, six forces at 0.1 mm", _FIT.format(1) + "burrlab.fit(curve, burr, engine=burrlab.VoxelEngine(seed=0))",
        "descents of four replicates", _FIT.format(4),
    ),
    Wait(
        "coverage study of 400 sets", _COVERAGE + "coverage_study(plan, burrlab.materials['bone'], n=400, seed=1)",
        "400 fits one by one", _COVERAGE + """
bone, burr = burrlab.materials["bone"], burrlab.Burr(3.0)
force = np.repeat(forces, 3)
exact = burrlab.penetration_velocity(burr, bone, force)
for k in range(400):
    z = np.random.default_rng(k).standard_normal(force.size)
    burrlab.fit(burrlab.VelocityCurve(force, exact * np.exp(0.08 * z)), burr)""",
    ),
)  # fmt: skip


def make(folder: Path) -> None:
    """The phantom as labels (NRRD, PNG), as a CT, and a trace of 4 s of drilling in it."""
    if (folder / "ear.h5").exists():
        return
    (folder / "png").mkdir(parents=True, exist_ok=True)
    phantom = temporal_bone(VOXEL, seed=1, size=(SIDE * VOXEL,) * 3)
    numbers, names = phantom.bone.tissue_numbers, list(VOLUMETRIC_DRILLING)
    labels = np.where((numbers == 1) | (numbers == 2), np.uint8(names.index("Bone") + 1), np.uint8(0))
    for number, (axis, parts) in PARTS.items():
        at = np.argwhere(numbers == number)
        low, high = at[:, axis].min(), at[:, axis].max() + 1
        which = (at[:, axis] - low) * len(parts) // (high - low)
        labels[tuple(at.T)] = np.array([names.index(part) + 1 for part in parts], np.uint8)[which]
    place = phantom.bone.spacing, phantom.bone.origin, np.eye(3), "phantom"
    colours = {i + 1: VOLUMETRIC_DRILLING[name] for i, name in enumerate(names)}
    volume = LabelVolume(labels, *place, {i + 1: name for i, name in enumerate(names)}, colours)
    write_volume(folder / "labels.seg.nrrd", volume)
    write_volume(folder / "grey.nrrd", Volume(phantom.bone.density.astype(np.int16) * 8 - 1000, *place))
    palette = np.zeros((len(names) + 1, 4), np.uint8)
    palette[1:] = [(*colour, 255) for colour in colours.values()]
    for k, labelled in enumerate(labels):
        Image.fromarray(palette[labelled.T]).save(folder / "png" / f"slice{k:04d}.png", compress_level=1)
    side = SIDE * VOXEL / 1000
    (folder / "stack.yaml").write_text(
        "volumes: [VOLUME phantom]\nVOLUME phantom:\n  name: phantom\n"
        f"  dimensions: {{x: {side}, y: {side}, z: {side}}}\n  scale: 1.0\n"
        f"  images: {{path: ./png, prefix: slice, format: png, count: {SIDE}}}\n"
    )
    times = np.linspace(0.0, 4.0, 401)
    device = ScriptedDevice(times, phantom.entry + np.outer(2.0 * times - 4.0, phantom.axis))
    with Session(
        phantom.bone, (Burr(3.0), materials["bone"]), device, seed=1, clock=Clock(wall_clock=False), record=folder / "ear.h5"
    ) as session:  # fmt: skip
        session.wait()


def spent(program: str, folder: Path) -> float:
    """CPU time of a Python program and its children [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run = subprocess.run(
        [sys.executable, "-c", program], cwd=folder, capture_output=True, text=True,
        env={**os.environ, "BURRLAB_CACHE": ""},  # nothing is kept from one run to the next
    )  # fmt: skip
    if run.returncode:
        raise RuntimeError(f"{program}\n{run.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def first_text(program: str, folder: Path) -> float:
    """Wall time until a program's terminal shows something [s]."""
    begin = time.perf_counter()
    controller, terminal = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=terminal, stdout=terminal, cwd=folder
    ) as run:
        os.read(controller, 1)
        seconds = time.perf_counter() - begin
        run.kill()
    os.close(controller)
    os.close(terminal)
    return seconds


def longest_ticks(folder: Path, native: Native) -> Iterator[str]:
    """Lines on ticks of a burr of 5 mm at places among the structures, each the first one there: the 99th percentile
    over the median of the plain loop at the same places. Tissues differ in c_e."""
    bone = usual_recipe(str(folder / "labels.seg.nrrd"), materials["bone"], {}).bone()
    tissues, burring = bone.tissues or (), Burring(VOXEL, 5.0)
    p, numbers, edge = bone.density, bone.tissue_numbers, int(burring.radius / VOXEL) + 4
    random = np.random.default_rng(1)
    structure = np.argwhere(numbers[edge:-edge, edge:-edge, edge:-edge] > 1) + edge  # behind air and bone
    places = VOXEL * (random.choice(structure, 200)[:, ::-1] + random.uniform(size=(200, 3)))
    plain, _ = native.plain_run(p.copy(), p, burring, 0, places[:25])
    for path in native.cpu_paths[1:]:  # not scalar
        turns = []
        for _ in range(7):
            core = Core.of(native, p, burring, path)
            core.set_tissues(numbers, len(tissues))
            turns.append(core.run(places).seconds)
        each = 1e6 * np.min(turns, axis=0)  # what the neighbours on this machine cost is left out
        yield (
            f"tick among structures, {path:<8} median {np.median(each):.0f} us, 99 % {np.quantile(each, 0.99):.0f} us, "
            f"{1e-6 * np.quantile(each, 0.99) / plain.median:.3f} of the plain loop's median"
        )


def lines(folder: Path, turns: int = 3) -> Iterator[str]:
    """Lines of the table; makes what they need."""
    make(folder)
    yield f"{'wait':<34} {'time [s]':>8} {'ratio':>6}  to"
    for wait in WAITS:
        clock = first_text if wait.program == _EXPERIMENT else spent
        pairs = [(clock(wait.program, folder), clock(wait.plain, folder)) for _ in range(turns)]
        own, plain = (statistics.median(times) for times in zip(*pairs, strict=True))
        yield (
            f"{wait.name:<34} {own:>8.2f} {statistics.median(a / b for a, b in pairs):>6.2f}  "
            f"{wait.plain_name} ({plain:.2f} s)"
        )
