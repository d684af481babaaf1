"""The core on aarch64 under qemu, with arrays and with NEON, gives the bits of this CPU's scalar path.

Debian: ``apt-get install g++-aarch64-linux-gnu qemu-user``; then ``pytest -m slow tests/python/test_aarch64.py``.
"""

import itertools
import os
import shutil
import struct
import subprocess
import sys
import sysconfig

import numpy as np
import pytest
from conftest import ROOT

from burrlab import _core

COMPILER, QEMU = "aarch64-linux-gnu-g++", "qemu-aarch64"


def block(material: _core.Material, tissues: bool) -> _core.VoxelBone:
    """The block of tests/cpp/digests.cpp, which makes the same scenes."""
    levels = np.full((32, 48, 48), 240, np.uint8)
    bone = _core.VoxelBone(levels, (0.125, 0.125, 0.1), (-2.9375, -2.9375, -3.15))
    if tissues:
        table = [
            _core.Tissue("bone", label=1, c_e=2.145, alpha=0.087, colour=(0, 0, 0)),
            _core.Tissue("soft", label=2, c_e=0.462, alpha=0.256, colour=(0, 0, 0)),
        ]
        numbers = (np.arange(levels.size) % 3 == 0).astype(np.uint8).reshape(levels.shape)
        bone.set_tissues(_core.Tissues(table, material), numbers)
    return bone


def line(bone: _core.VoxelBone, value: float) -> str:
    return f"{bone.digest()} {struct.pack('>d', value).hex()}"


def descent(shape: str, scheme: str, tissues: bool) -> str:
    material = _core.Material("bone", c_e=2.145, alpha=0.087, shape=shape)
    bone = block(material, tissues)
    contact = _core.BurrContact(bone, _core.Burr(1.5), material, 7, scheme=scheme)
    return line(
        bone,
        contact.hold(0.5, (0, 0, 1.5), (0, 0, -1), from_=0.0, travel=1.0, dt=1.0, ticks=300).position[-1],
    )


def session() -> str:
    material = _core.Material("bone", c_e=2.145, alpha=0.087, force_exponent=1.7, rate_exponent=0.5)
    bone = block(material, tissues=True)
    executor = _core.TickExecutor(bone, [(_core.Burr(1.5), material), (_core.Burr(1.0), material)], 11)
    devices = [
        _core.ScriptedDevice([0.0, 1.0], path)
        for path in ([(-1, 0, 1.5), (-0.5, 0.5, 1)], [(1, 0, 0.75), (1.5, -0.5, 0.5)])
    ]
    loop = _core.HapticLoop(executor, devices, wall_clock=False, ticks=800)
    loop.start()
    loop.wait(300.0)
    loop.stop()
    return line(bone, executor.probe(0, (-0.5, 0.5, 1)).force[2])


@pytest.mark.slow
@pytest.mark.skipif(
    not (shutil.which(COMPILER) and shutil.which(QEMU)), reason=f"{COMPILER} and {QEMU} are needed"
)
@pytest.mark.usefixtures("keep_cpu_path")
def test_another_cpu_gives_the_same_digests_of_descents_and_of_a_session(tmp_path):
    cmake = [sys.executable, "-m", "cmake"]
    configure = [
        *cmake, "-S", ROOT, "-B", tmp_path, "-DCMAKE_BUILD_TYPE=Release", "-DCMAKE_SYSTEM_NAME=Linux",
        "-DCMAKE_SYSTEM_PROCESSOR=aarch64", f"-DCMAKE_CXX_COMPILER={COMPILER}",
        "-DBURRLAB_TESTS=ON", f"-DCMAKE_PREFIX_PATH={sysconfig.get_path('purelib')}/cmeel.prefix",
    ]  # fmt: skip
    for command in (configure, [*cmake, "--build", tmp_path, "--target", "digests", "-j", "2"]):
        subprocess.run(command, check=True, capture_output=True)
    program = [QEMU, "-L", "/usr/aarch64-linux-gnu", tmp_path / "tests/cpp/digests"]
    theirs = {}
    for path in ("portable", "neon"):
        done = subprocess.run(
            program, check=True, capture_output=True, text=True, env={**os.environ, "BURRLAB_CPU_PATH": path}
        )
        theirs[path] = done.stdout.splitlines()

    _core.use_cpu_path(_core.cpu_paths()[0])
    shapes, schemes = ("parabolic", "linear", "constant", "power(1.5)"), ("layer", "cell")
    ours = [descent(*scene) for scene in itertools.product(shapes, schemes, (False, True))]
    ours.append(session())
    assert theirs == {"portable": ours, "neon": ours}
    assert len(set(ours)) == len(ours)
