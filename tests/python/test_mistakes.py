"""Natural mistakes of newcomers: each is answered by one sentence that says what to give instead."""

import contextlib
import io
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
from replica_scenes import soon
from session_scenes import refused

import burrlab
from burrlab import Burr, VelocityCurve, VoxelBone, descend, fit, force_sweep, materials  # noqa: F401
from burrlab.cli.main import main
from burrlab.common.check import refuse
from burrlab.common.figures import paper  # noqa: F401  # a row calls it
from burrlab.common.progress import doing, foretold, reporter, stoppable

Material, bone, burr = burrlab.Material, materials["bone"], Burr(3.0)
block = VoxelBone.block((8, 8, 3), 0.2, origin=(-4, -4, -3))
contact = burrlab.BurrContact(block, burr, bone, seed=1)
curve = VelocityCurve([1, 2, 3], [1, 2, 3])
hand = burrlab.HandDevice((0, 0, 5))

# A call or command, and below it what it raises or warns of: "..." at the end stands for the rest of the sentence.
MISTAKES = """
Burr("3")
    TypeError: radius must be a number [mm], got '3'
Material("resin", c_e="2,1", alpha=0.1)
    TypeError: c_e must be a number [N/mm^2], got '2,1'
Material("resin", c_e=2.1, alpha=0.1, shape=2)
    TypeError: shape must be a name or a Shape, such as Shape('parabolic'), got 2
VoxelBone.block(10, 0.1)
    TypeError: size must be three numbers (x, y, z) [mm], got 10
VoxelBone.block((10, 10, 10), "0.1")
    TypeError: spacing must be a number or three of them (x, y, z) [mm], got '0.1'
VoxelBone([[[1]]], 0.1)
    TypeError: density must be a NumPy array, got [[[...]]]
burrlab.Tissue("a", label="b", c_e=1, alpha=0)
    TypeError: label must be a whole number, got 'b'
burrlab.HandDevice("a")
    TypeError: start must be three numbers (x, y, z) [mm], got 'a'
class_of_device()
    NotImplementedError: Device cannot be subclassed in Python, which is too slow for a tick: put positions into a MailboxDevice, or ...
burrlab.Tissues({"bone": 1}, bone)
    TypeError: tissues must be a list, each a Tissue, got {'bone': 1}
descend(burr, bone, force="1")
    TypeError: force must be a number, got '1'
descend(burr, bone, 2, seed="a")
    ValueError: seed must be a whole number from 0 and below 2^64, got 'a'
descend(burr, "bone", 2)
    TypeError: material must be a Material, such as materials['bone'], got 'bone'
descend(bone, burr, 2)
    TypeError: burr must be a Burr, such as Burr(3.0), got Material('bone', ...
descend(burr, bone, 2, voxel="0.1")
    ValueError: voxel must be of real numbers that a float holds, got '0.1'
descend(burr, bone, 2, rig=True)
    TypeError: rig must be a Rig, such as VirtualRig(contact, specimen); without a rig, ideal=False makes it, got True
descend(burr, bone, 2, voxel=0.2, settings=burrlab.DescentSettings(dt=1000))
    ValueError: dt must be at most 33.3 ms, or the force swings: got 1000 ms
descend(burr, bone, 2, ideal="yes")
    TypeError: ideal must be True or False, got 'yes'
descend(burr, bone, 2, progress=3)
    TypeError: progress must be a function of the fraction done, or True for a bar, got 3
descend(burr, bone, 2, controller=2.0)
    TypeError: controller must be a ForceController, such as ForceController(2.0), got 2.0
descend(burr, bone, 2, voxl=0.1)
    TypeError: descend() got an unexpected keyword argument 'voxl'
force_sweep(burr, "bone", [2.0])
    TypeError: material must be a Material, such as materials['bone'], got 'bone'
force_sweep(burr, bone, 2.0)
    ValueError: forces must be a list of at least one force
force_sweep(burr, bone, ["1", "2"])
    ValueError: forces must be of real numbers that a float holds, got ['1', '2']
burrlab.VirtualRig(block, burr)
    TypeError: contact must be a BurrContact, such as BurrContact(bone, burr, material, seed=1), got VoxelBone(...
burrlab.Session("bone", (burr, bone), hand)
    TypeError: bone must be a VoxelBone, such as VoxelBone.block((10, 10, 5), 0.1), got 'bone'
burrlab.ExperimentPlan([3.0])
    TypeError: velocities must be a list of (radius, forces, repeats), got [3.0]
VelocityCurve([1, 2], [1, 2], radius="3")
    ValueError: radius must be of real numbers that a float holds, got '3'
fit("curve.csv", burr)
    TypeError: data must be a VelocityCurve, Indentation or DepthTrace or several of them, such as ...
fit(curve)
    ValueError: a burr must be given for data without a radius: got none for VelocityCurve(3 rows, ...
fit(curve, burr).region(90)
    ValueError: level must be one of 68, 95, 99.7: got 90
materials["Bone"]
    KeyError: "material must be one of bone, ..., got 'Bone'; did you mean 'bone'?"
burrlab.Brur
    AttributeError: module 'burrlab' has no attribute 'Brur'
burrlab.read_volume(3)
    TypeError: path must be a path or a list of paths, got 3
fit({"force_N": [1, 2, 3], "velocity_mm_s": [1, 2, 3]}, burr)
    TypeError: data must be a VelocityCurve, Indentation or DepthTrace or several of them, such as VelocityCurve.from_dataframe(...
VelocityCurve(None, None)
    ValueError: force must be a list of numbers, got None
VelocityCurve([1, 2], [1, 2], radius=[3])
    ValueError: radius must be a single number, got [3]
VelocityCurve([1, 2], [1, 2], status="ok")
    ValueError: status must be a list of texts, one a force, got 'ok'
VelocityCurve([1, 2], [1, 2], provenance="me")
    TypeError: provenance must be a mapping, such as {'operator': 'AB'}, got 'me'
VelocityCurve.from_csv(None)
    TypeError: file must be a path or an open file, got None
VelocityCurve.from_csv("a.csv", columns="force_N")
    ValueError: columns must map names to texts, such as {'force': ...}: got 'force_N'
VelocityCurve.from_csv("a.csv", decimal=0)
    ValueError: decimal must be a text: got 0
VelocityCurve.from_dataframe("a.csv")
    TypeError: frame must be a DataFrame or a mapping (a file is for from_csv), got 'a.csv'
VelocityCurve.from_dataframe({"force_N": [1, 2], "velocity_mm_s": [1]})
    ValueError: dict: columns must be lists of one length
VelocityCurve.from_dataframe({"a": [1], "b": [2]}, force=0)
    ValueError: dict: no column is 0, velocity_mm_s; there are a, b
VelocityCurve.from_dataframe({"force_N": [1], "velocity_mm_s": [2]}, unit="mm")
    ValueError: dict: unit must be one that a column can have (force_N, velocity_mm_s): got 'mm'
curve.to_csv(None)
    TypeError: file must be a path or an open text file, got None
curve.plot("a.png")
    TypeError: ax must be Axes of matplotlib, got 'a.png'; to save: plot().figure.savefig(file)
descend(burr, bone, np.array([2.0]))
    TypeError: force must be a number, got array([2.])
descend(burr, bone, 2, voxel=[0.1, 0.1])
    ValueError: voxel must be a number or three from 1e-6 to 1e6 [mm], got [0.1, 0.1]
descend(burr, bone, 2, settings=burrlab.DescentSettings(stop=[1, 2]))
    ValueError: stop must be a single number, got [1, 2]
burrlab.mean_field_descent(burr, bone, [1, 2])
    ValueError: force must be a single number, got array([1., 2.])
burrlab.synthetic_curve(burr, bone, [1, 2], scatter="8 %")
    ValueError: scatter must be of real numbers that a float holds, got '8 %'
burrlab.synthetic_curve(burr, bone, [1, 2], scatter=8)
    UserWarning: scatter = 8 is 800 %; 8 % is 0.08
burrlab.synthetic_indentation(3.0, bone, [0.1])
    TypeError: burr must be a Burr, such as Burr(3.0), got 3.0
burrlab.ExperimentPlan([("3", [1, 2], 1)])
    ValueError: radius in velocities must be of real numbers that a float holds, got '3'
burrlab.ExperimentPlan([(3.0, 2, 1)])
    ValueError: forces in velocities must be positive and finite, at least one: got 2
burrlab.ExperimentPlan([(3.0, [1, 2], 1.5)])
    ValueError: repeats in velocities must be a whole number from 0 and below 2^31, got 1.5
burrlab.compare(fit(curve, burr), fit(curve, burr), names="ab")
    ValueError: names must be 2 different texts: got 'ab'
burrlab.compare(fit(curve, burr), fit(curve, burr), margin="a")
    ValueError: margin must be of real numbers that a float holds, got 'a'
fit(curve, burr).test("1.5", 0.1)
    TypeError: c_e must be a number, got '1.5'
fit(curve, burr, plausible=(1, 2))
    TypeError: plausible must be a dict such as {'c_e': (1, 3)}, got (1, 2)
fit(curve, burr, plausible={"ce": (1, 2)})
    ValueError: plausible may hold 'c_e' and 'alpha' alone: got 'ce'; did you mean 'c_e'?
materials.bone
    AttributeError: materials has no attribute 'bone': materials['bone']
Material(c_e=0.087, alpha=2.145)
    UserWarning: c_e = 0.087 N/mm^2 and alpha = 2.145 1/ms look swapped...
Material(c_e=2.145, alpha=87)
    UserWarning: c_e = 2.145 N/mm^2 and alpha = 87 1/ms look like numbers of other units...
VoxelBone.block((10.05, 1, 1), 0.1)
    UserWarning: size (10.05, 1, 1) mm is no whole number of voxels of (0.1, 0.1, 0.1) mm: the block has (10.1, 1, 1) mm
command("descend --forec 2")
    SystemExit: burrlab descend: unknown option --forec; did you mean '--force'?
command("sweep --forces 1,2 --ou x.csv")
    SystemExit: burrlab sweep: unknown option --ou; did you mean '--out'?
command("descend --force 2 --material Bone")
    SystemExit: burrlab descend: argument --material: invalid choice: 'Bone' (choose from 'bone', ...); did you mean 'bone'?
command("decsend --force 2")
    SystemExit: burrlab: argument COMMAND: invalid choice: 'decsend' (choose from 'descend', ...
command("")
    SystemExit: burrlab: the following arguments are required: COMMAND, one of descend, sweep, ...
paper("3.5")
    ValueError: width must be one of single, double: got '3.5'
command("fit / --radius 3")
    SystemExit: burrlab fit: /: Is a directory
"""
ROWS = re.findall(r"^(\S.*)\n    (.*)$", MISTAKES, re.MULTILINE)


def class_of_device() -> Any:
    return type("D", (burrlab.Device,), {})


def command(words: str) -> None:
    with contextlib.redirect_stderr(io.StringIO()) as told, contextlib.suppress(SystemExit):
        main(words.split())
    raise SystemExit(told.getvalue().rstrip())


@pytest.mark.parametrize(("call", "answer"), ROWS, ids=[call for call, _ in ROWS])
def test_a_mistake_is_answered_by_one_sentence(call: str, answer: str) -> None:
    if answer.startswith("UserWarning"):  # and the call is done
        with pytest.warns(UserWarning) as warned:  # noqa: PT030
            assert eval(call) is not None
        error: Any = warned[0].message
    else:
        with pytest.raises(BaseException) as raised:  # noqa: PT011  # the row names it
            eval(call)
        error = raised.value
    said = f"{type(error).__name__}: {error}"
    assert re.fullmatch(".*".join(map(re.escape, answer.split("..."))), said, re.DOTALL)
    for dump in ("incompatible", "supported:", "std::", "Annotated", "Supports", "\n"):
        assert dump not in said


def test_ctrl_c_while_a_value_is_converted_stays_ctrl_c() -> None:
    class Center:
        interrupted = False

        def __array__(self, *_: Any, **__: Any) -> Any:
            if not self.interrupted:
                self.interrupted = True
                raise KeyboardInterrupt
            return np.zeros(3)

    refused((lambda: burrlab.HandDevice(Center()), None, KeyboardInterrupt))


def test_there_are_enough_rows() -> None:
    assert len(ROWS) == len(set(ROWS)) >= 60


def test_true_shows_a_bar(capsys: pytest.CaptureFixture[str]) -> None:
    descend(burr, bone, 2.0, voxel=0.4, seed=1, ideal=True, progress=True)
    assert "descent:   0%|" in capsys.readouterr().err
    tell = reporter(True, "work")
    time.sleep(0.15)  # a bar is drawn at most every 0.1 s
    tell(0.5)
    assert "work:  50%" in capsys.readouterr().err


def test_long_work_says_how_long_once(monkeypatch, caplog: pytest.LogCaptureFixture) -> None:
    clock = iter((0.0, 0.5, 2.0, 3.0))
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    tell = foretold("descent at dt = 0.001 ms, voxel = 0.1 mm")
    with caplog.at_level(logging.INFO, "burrlab"):
        for done in (0.2, 0.21, 0.24, 0.26):
            tell(done)
    assert caplog.messages == ["descent at dt = 0.001 ms, voxel = 0.1 mm: about 38 s more; Ctrl-C ends it"]


def test_work_without_parts_says_what_is_done(monkeypatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr("burrlab.common.progress.LONG", 0.05)
    with doing("all of it"), doing("a part"):
        time.sleep(0.5)
    with doing("short"):
        pass
    assert caplog.messages == ["a part: 0 s so far; Ctrl-C ends it"]


def test_an_interrupt_does_not_wait_for_a_library() -> None:
    begin, ended = time.monotonic(), threading.Event()
    threading.Timer(0.1, os.kill, [os.getpid(), signal.SIGINT]).start()
    refused((lambda: stoppable(lambda: ended.wait(20.0)), None, KeyboardInterrupt))
    assert time.monotonic() - begin < 10.0
    ended.set()
    assert stoppable(lambda: 3) == 3
    refused((lambda: stoppable(lambda: refuse(True, "as of the work")), "as of the work"))


def test_a_block_that_takes_long_says_that_it_is_made(monkeypatch, caplog: pytest.LogCaptureFixture) -> None:
    def slow_half_space(*arguments: object, **options: object) -> object:
        soon(lambda: caplog.messages, 60.0)
        return burrlab.half_space(*arguments, **options)

    monkeypatch.setattr("burrlab.common.progress.LONG", 0.05)
    monkeypatch.setattr("burrlab.descent.descent.half_space", slow_half_space)
    assert descend(burr, bone, 2.0, seed=1, ideal=True).status == "ok"
    assert caplog.messages[0] == "the block of bone: 0 s so far; Ctrl-C ends it"


def test_a_command_says_what_looks_swapped(capsys: pytest.CaptureFixture[str]) -> None:
    main(["descend", "--force", "2", "--c-e", "0.087", "--alpha", "2.145", "--ideal", "--voxel", "0.4"])
    assert capsys.readouterr().err.startswith(
        "burrlab: c_e = 0.087 N/mm^2 and alpha = 2.145 1/ms look swapped:"
    )


def test_levels_are_numbers_too() -> None:
    found = fit(curve, burr)
    for levels in (found.intervals["c_e"], found.identified.intervals):  # type: ignore[union-attr]
        assert levels[95] is levels["95"]
    assert found.region(95) == found.region("95")


@pytest.mark.parametrize(
    "shown",
    [burr, bone, block, burrlab.Volume(np.zeros((2, 3, 4)), (1, 1, 1), (0, 0, 0), np.eye(3), "a.nrrd")],
)
def test_objects_show_a_table_in_notebooks(shown: Any) -> None:
    assert re.match(rf"<p>{type(shown).__name__}</p><table.*</table>$", shown._repr_html_(), re.DOTALL)


def test_the_face_is_tidy() -> None:
    assert re.search(r"^name +c_e \[N/mm\^2\] .*\n(.*\n){2}pvc +0.462 ", str(materials))
    told = (
        "import burrlab, types; burrlab.fit, burrlab.descend;"
        "print([n for n in dir(burrlab) if isinstance(getattr(burrlab, n), types.ModuleType)])"
    )
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
