"""The library as programs in C++ and C use it: configured without Python, installed, found and linked.

Debian: ``apt-get install g++ clang clang-tidy pkg-config``; then ``pytest -m slow tests/python/test_library.py``.
"""

import ctypes
import os
import re
import shutil
import subprocess
import sysconfig
from pathlib import Path

import cmake
import numpy as np
import pytest
from conftest import ROOT

import burrlab

EIGEN = Path(sysconfig.get_path("purelib")) / "cmeel.prefix"
COMPILERS = {"g++": "gcc", "clang++": "clang"}
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror", "-fsyntax-only"]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tools(tmp_path_factory):
    """An environment whose PATH has compilers, linkers and CMake, and no Python."""
    folder = tmp_path_factory.mktemp("tools")
    names = [*COMPILERS, *COMPILERS.values(), "as", "ld", "ar", "ranlib", "make", "uname", "sh", "rm", "nm"]
    for name in names:
        if place := shutil.which(name):
            (folder / name).symlink_to(place)
    (folder / "cmake").symlink_to(Path(cmake.CMAKE_BIN_DIR) / "cmake")
    return {"PATH": str(folder), "HOME": str(folder)}


def run(tools, *command, **options):
    return subprocess.run(
        [str(part) for part in command], env=tools, check=True, capture_output=True, text=True, **options
    ).stdout


@pytest.fixture(
    scope="module", params=[(c, kind) for c in COMPILERS for kind in ("static", "shared")], ids="-".join
)
def installed(request, tools, tmp_path_factory):
    """The compiler, whether the library is shared, and where it is installed."""
    compiler, kind = request.param
    if not shutil.which(compiler):
        pytest.skip(f"{compiler} is needed")
    build, prefix = tmp_path_factory.mktemp("build"), tmp_path_factory.mktemp("prefix")
    run(tools, "cmake", "-S", ROOT, "-B", build, f"-DCMAKE_CXX_COMPILER={compiler}",
        f"-DBUILD_SHARED_LIBS={kind == 'shared'}", f"-DCMAKE_PREFIX_PATH={EIGEN}")  # fmt: skip
    run(tools, "cmake", "--build", build, "-j", "2")
    run(tools, "cmake", "--install", build, "--prefix", prefix)
    cached = (build / "CMakeCache.txt").read_text()
    assert "CMAKE_BUILD_TYPE:STRING=Release" in cached
    assert "UNITY" not in cached
    assert "Python_EXECUTABLE" not in cached
    return compiler, kind == "shared", prefix


def center(i):
    return -4.0 + i / 16384, (i & 1023) / 2048, 2.0 - (i & 4095) / 4096


@pytest.fixture(scope="module")
def ticks():
    """Digest and sum of forces of the ticks of tests/library, through the Python module."""
    bone = burrlab.VoxelBone(np.full((15, 30, 70), 255, np.uint8), (0.2, 0.2, 0.2), (-6.9, -2.9, -2.9))
    contact = burrlab.BurrContact(bone, burrlab.Burr(2.0), burrlab.materials["bone"], 5)
    total = 0.0
    for i in range(100_000):
        total += float(contact.step(center(i), 1.0).force[2])
    return bone.digest(), total


@pytest.mark.parametrize("flags", ["-O2", "-O0", "-O3 -march=native -ffast-math"])
def test_ticks_are_the_modules_to_the_bit(installed, tools, ticks, flags, tmp_path):
    compiler, _, prefix = installed
    run(tools, "cmake", "-S", ROOT / "tests/library", "-B", tmp_path, f"-DCMAKE_CXX_COMPILER={compiler}",
        f"-DCMAKE_C_COMPILER={COMPILERS[compiler]}", f"-DCMAKE_PREFIX_PATH={prefix}", "-DCMAKE_BUILD_TYPE=None",
        f"-DCMAKE_CXX_FLAGS={flags}", f"-DCMAKE_C_FLAGS={flags}")  # fmt: skip
    run(tools, "cmake", "--build", tmp_path)
    for program in ("ticks", "ticks_c"):
        digest, total, _ = run(tools, tmp_path / program).split()
        assert (digest, float.fromhex(total)) == ticks


def test_headers_alone(installed, tools):
    compiler, _, prefix = installed
    strict = [*STRICT, "-Wno-sign-conversion"] if compiler == "clang++" else STRICT
    headers = sorted((prefix / "include").rglob("*.h*"))
    assert len(headers) > 20
    for standard in ("c++17", "c++20"):
        for header in headers:
            run(tools, compiler, f"-std={standard}", *strict, "-I", prefix / "include", "-isystem", EIGEN / "include/eigen3",
                "-x", "c++", "-", input=f"#include <{header.relative_to(prefix / 'include')}>\n")  # fmt: skip


@pytest.mark.skipif(not shutil.which("clang-tidy"), reason="clang-tidy is needed")
def test_headers_are_tidy(tmp_path):
    headers = ROOT / "cpp/include"
    names = [f"#include <{header.relative_to(headers)}>\n" for header in sorted(headers.rglob("*.h*"))]
    (tmp_path / "all.cpp").write_text("".join(names))
    found = subprocess.run(
        ["clang-tidy", "--checks=-*,bugprone-*,performance-*", "--header-filter=.*burrlab.*", tmp_path / "all.cpp", "--",
         "-std=c++17", f"-I{headers}", "-isystem", EIGEN / "include/eigen3"], check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert "warning:" not in found.stdout


def test_only_public_symbols_are_visible(installed, tools):
    _, shared, prefix = installed
    if not shared:
        pytest.skip("a static library hides by its objects")
    library = next(prefix.glob("lib*/libburrlab.so"))
    assert re.search(r"libburrlab\.so\.0\.3$", os.readlink(library))
    names = run(tools, "nm", "-D", "--defined-only", library).split()[2::3]
    assert len(names) > 100
    assert all(re.match(r"_ZNK?7burrlab|_ZT[ISV]N7burrlab|burrlab_", name) for name in names)
    assert "burrlab_burr_step" in names


@pytest.mark.skipif(not shutil.which("pkg-config"), reason="pkg-config is needed")
def test_pkg_config_and_a_parent_project(installed, tools, tmp_path):
    compiler, shared, prefix = installed
    folder = next(prefix.glob("lib*/pkgconfig"))
    options = subprocess.check_output(
        ["pkg-config", "--cflags", "--libs", "burrlab"],
        env={**os.environ, "PKG_CONFIG_PATH": str(folder)},
        text=True,
    ).split()
    run(tools, compiler, "-std=c++17", ROOT / "examples/cpp/tick.cpp", "-o", tmp_path / "tick", *options,
        f"-Wl,-rpath,{folder.parent}")  # fmt: skip
    found = run(tools, tmp_path / "tick")
    if shared:
        return
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.22)\nproject(parent CXX)\n"
        f"add_subdirectory({ROOT} burrlab)\nadd_executable(tick {ROOT}/examples/cpp/tick.cpp)\n"
        "target_link_libraries(tick burrlab::burrlab)\nget_target_property(unity tick UNITY_BUILD)\n"
        'if(unity OR CMAKE_BUILD_TYPE OR CMAKE_POSITION_INDEPENDENT_CODE)\n  message(FATAL_ERROR "forced")\nendif()\n'
    )
    build = tmp_path / "build"
    configured = subprocess.run(
        ["cmake", "-S", tmp_path, "-B", build, f"-DCMAKE_CXX_COMPILER={compiler}", f"-DCMAKE_PREFIX_PATH={EIGEN}"],
        env=tools, check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert "nine times" in configured.stdout + configured.stderr
    run(tools, "cmake", "--build", build, "--target", "tick", "-j", "2")
    assert run(tools, build / "tick") == found


class Grid(ctypes.Structure):
    _fields_ = [("size", ctypes.c_uint32), ("shape", ctypes.c_int32 * 3), ("spacing", ctypes.c_double * 3),
                ("origin", ctypes.c_double * 3)]  # fmt: skip


class Settings(ctypes.Structure):
    _fields_ = [("size", ctypes.c_uint32), ("index", ctypes.c_uint32), ("radius", ctypes.c_double),
                ("constants", ctypes.c_double * 4), ("shape", ctypes.c_char_p), ("to_bone", ctypes.c_double * 12),
                ("longest_tick", ctypes.c_double), ("seed", ctypes.c_uint64), ("tick", ctypes.c_uint64)]  # fmt: skip


class Motion(ctypes.Structure):
    _fields_ = [("size", ctypes.c_uint32), ("on", ctypes.c_int32), ("center", ctypes.c_double * 3),
                ("reference", ctypes.c_double * 3), ("dt", ctypes.c_double)]  # fmt: skip


class Feel(ctypes.Structure):
    _fields_ = [("size", ctypes.c_uint32), ("touching", ctypes.c_int32), ("force", ctypes.c_double * 3),
                ("torque", ctypes.c_double * 3), ("penetration", ctypes.c_double), ("removed", ctypes.c_double),
                ("tick", ctypes.c_uint64)]  # fmt: skip


def test_ticks_by_ctypes(installed, ticks):
    _, shared, prefix = installed
    if not shared:
        pytest.skip("ctypes loads a shared library")
    library = ctypes.CDLL(str(next(prefix.glob("lib*/libburrlab.so"))))
    for name in ("bone_create", "burr_create"):
        getattr(library, f"burrlab_{name}").restype = ctypes.c_void_p
    library.burrlab_burr_lift.argtypes = [ctypes.c_void_p, ctypes.c_uint64]
    assert library.burrlab_abi_version() == 1
    grid, settings, motion, feel = (kind(ctypes.sizeof(kind)) for kind in (Grid, Settings, Motion, Feel))
    grid.shape[:], grid.spacing[:], grid.origin[:] = (15, 30, 70), (0.2, 0.2, 0.2), (-6.9, -2.9, -2.9)
    bone = ctypes.c_void_p(library.burrlab_bone_create(ctypes.byref(grid), None, 0, None, 0))
    assert library.burrlab_burr_defaults(ctypes.byref(settings), b"bone") == 0
    settings.radius, settings.seed, settings.to_bone[:] = 2.0, 5, np.eye(3, 4).ravel()
    burr = ctypes.c_void_p(library.burrlab_burr_create(bone, ctypes.byref(settings)))
    motion.on, motion.dt, total = 1, 1.0, 0.0
    for i in range(100_000):
        motion.center[:] = center(i)
        assert library.burrlab_burr_step(burr, ctypes.byref(motion), ctypes.byref(feel)) == 0
        total += feel.force[2]
        library.burrlab_burr_lift(burr, feel.tick)
    digest = ctypes.create_string_buffer(33)
    assert library.burrlab_bone_digest(bone, digest) == 0
    assert (digest.value.decode(), total) == ticks
    library.burrlab_burr_destroy(burr)
    library.burrlab_bone_destroy(bone)
    flat = str(ROOT / "tests/golden/files/flat.burr").encode()  # with tissues, whose constants count
    library.burrlab_bone_open.restype = ctypes.c_void_p
    bone = ctypes.c_void_p(library.burrlab_bone_open(flat, None, 0))
    settings.radius, settings.c_e = 1.0, 99.0
    burr = ctypes.c_void_p(library.burrlab_burr_create(bone, ctypes.byref(settings)))
    assert burr.value
    library.burrlab_burr_destroy(burr)
    library.burrlab_bone_destroy(bone)
