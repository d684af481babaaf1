"""The command line."""

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import call, refusal, result, said

import burrlab


def test_a_closed_pipe_ends_silently():
    reader, writer = os.pipe()
    os.close(reader)
    for words in (["materials"], ["--help"]):
        program = [sys.executable, "-m", "burrlab", *words]
        done = subprocess.run(program, stdout=writer, stderr=subprocess.PIPE, timeout=60, check=False)
        assert (done.returncode, done.stderr) == (141, b"")
    os.close(writer)


NO_WORK = """
import contextlib, sys; from burrlab.cli import main
for words in (['--version'], ['--help'], ['desend'], ['fit', '--verbos'], ['fit', '--help'],
              ['session', '--devize'], ['view', '--pgn'], ['experiment', 'run', '--al'], ['tissues', '-x']):
    with contextlib.suppress(SystemExit): main(words)
print(*{'h5py', 'matplotlib', 'nlopt', 'scipy'} & set(sys.modules))
"""
A_FIT = """
import io, sys, burrlab
file = io.StringIO('force_N,velocity_mm_s\\n0.5,0.3\\n1,0.8\\n1.5,1.4\\n2,2.2\\n')
burrlab.fit(burrlab.VelocityCurve.from_csv(file), burrlab.Burr(3.0)).report()
print(*{'h5py', 'matplotlib', 'scipy.stats'} & set(sys.modules))
"""


@pytest.mark.parametrize("program", [NO_WORK, A_FIT])
def test_no_library_is_imported_that_is_not_needed(program):
    """Not for what needs no work; and neither figures nor distributions for a fit."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == ""


def test_standard_input_and_quiet(capsys, monkeypatch, tmp_path):
    """`-` is a CSV from standard input; notes, which --quiet leaves out, name it."""
    file, text = tmp_path / "a.csv", "F,v\n0.5,0.3\n1,0.8\n1.5,1.4\n2,2.2\n"
    file.write_text(text)
    words = ["compare", "-", file, "--radius", 3, "--columns", "force=F,velocity=v"]
    for quiet in ([], ["--quiet"]):
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
        code, out, err = call(capsys, *words, *quiet)
        assert (code, "standard input and " in out, "burrlab: -: " in err) == (0, True, not quiet)
        assert not (quiet and err)


def test_another_law(capsys, tmp_path):
    law, burr = burrlab.Law("parabolic", 2, 1), burrlab.Burr(3.0)
    curve, presses, figure, result = (tmp_path / name for name in ("a.csv", "i.csv", "laws.png", "laws.json"))
    material = law.material(2.1, 0.09)
    burrlab.synthetic_curve(
        burr, material, [0.3, 0.5, 0.8, 1.2, 1.6], repeats=3, scatter=0.05, seed=1
    ).to_csv(curve)
    burrlab.synthetic_indentation(burr, material, [0.1, 0.2, 0.4], repeats=4, scatter=0.05, seed=1).to_csv(
        presses
    )
    told = said(capsys, "laws", curve, "--indentation", presses, "--plot", figure, "--json", result)
    assert ("Kobra alone is left." in told, figure.stat().st_size > 10_000) == (True, True)
    assert json.loads(result.read_text())["rows"][0]["law"] == "kobra"
    assert said(capsys, "laws", curve, "--laws", "paper,kobra").count("contradicted") == 1
    exponents = ["--force-exponent", 2, "--rate-exponent", 1]
    told = said(capsys, "fit", curve, "--indentation", presses, *exponents)
    assert "law parabolic, F ~ h^2, rate ~ F^1" in told


def test_overrides_and_figure(capsys, tmp_path):
    figure, file = tmp_path / "run.png", tmp_path / "run.json"
    told = said(
        capsys, "descend", "--force", 1.0, "--c-e", 1.5, "--alpha", 0.1, "--shape", "quartic", "--voxel", 0.6, "--ideal",
        "--force-exponent", 2, "--rate-exponent", 0.5, "--seed", 2, "--plot", figure, "--json", file,
    )  # fmt: skip
    for words in ("mm/s", "coarse", "seed 2"):
        assert words in told
    assert figure.stat().st_size > 10_000
    made = json.loads(file.read_text())["material"]
    assert (made["c_e"], made["alpha"], made["shape"]) == (1.5, 0.1, "quartic")
    assert (made["force_exponent"], made["rate_exponent"]) == (2.0, 0.5)


CSV = "force_N,velocity_mm_s\n1.0,0.5\n1.2,{cell}\n1.4,0.9\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["descend"], "--force"),
        (["descend", "--force", "-1"], "--force: must be positive"),
        (["descend", "--force", "1", "--radius", "0"], "--radius: must be positive"),
        (["descend", "--force", "1", "--dt", "-1"], "--dt: must be positive"),
        (["descend", "--force", "25"], "force must be within the rig's range"),
        (["descend", "--force", "1", "--shape", "round"], "--shape"),
        (["descend", "--force", "1", "--force-exponent", "0.5"], "force_exponent must be 1 to 8, got 0.5"),
        (["descend", "--force", "1", "--volume", "none.nrrd"], "--volume needs --map and --entry and --axis"),
        (["descend", "--force", "1", "--map", "1:2"], "--map goes with --volume"),
        (["descend", "--force", "1", "--map", "2:1"], "LO below HI"),
        (["descend", "--force", "1", "--axis", "1,2"], "--axis: must be X,Y,Z"),
        (["descend", "--force", "1", "--seed", "x"], "--seed"),
        (["sweep", "--forces", "1:2", "--out", "x.csv"], "--forces: must be FIRST:LAST:COUNT"),
        (
            ["design", "none.json", "--compare", "0.9", "--specimens", "12:3"],
            "--specimens: must be FIRST:LAST, the smaller",
        ),
        (["fit", "none.csv", "--radius", "3"], "none.csv"),
        (["fit", "none.csv", "--test", "2.1"], "--test: must be C_E,ALPHA"),
        (["fit", "none.csv", "--store", "s.jsonl"], "--store goes with --engine voxel"),
        (["fit", "none.csv", "--voxel", "0.1"], "--voxel goes with --engine voxel"),
        (["compare", "a.csv", "a.csv"], "needs another FILE.csv for each data set: got a.csv twice"),
        (["fit", "--indentation", "i.csv"], "a fit needs velocities"),
        (["fit", "a.csv", "--test", "2.1,-1"], "must be positive"),
        (["fit", "a.csv", "--radius", "3", "--indentation", "missing.csv"], "missing.csv"),
        (["fit", "a.csv", "--radius", "3", "--trace", "missing.csv"], "missing.csv"),
        (["fit", "a.csv", "--region", "figure.xyz"], "must end in one of"),
        (["fit", "a.csv", "--profile", "/nowhere/p.png"], "--profile: /nowhere/p.png cannot be written"),
        (["fit", "a.csv", "--radius", "3", "--residuals", "sigma"], "need a sigma"),
        (["fit", "a.csv", "--engine", "oracle"], "invalid choice"),
        (["fit", "a.csv"], "--radius must be given: a.csv does not say it"),
        (["fit", "wrong.csv", "--radius", "3"], "wrong.csv, line 3"),
        (
            ["fit", "a.csv", "--radius", "3", "--engine", "voxel", "--store", "a.csv"],
            "store must be a file of burrlab results",
        ),
        (["descend", "--force", "1", "--json", "none/x.json"], "--json: none/x.json cannot be written"),
        (["descend", "--force", "1", "--plot", "x.xyz"], "must end in one of"),
    ],
)
def test_wrong_options_exit_2_with_one_line(capsys, here, arguments, message):
    (here / "a.csv").write_text(CSV.format(cell="0.7"))
    (here / "wrong.csv").write_text(CSV.format(cell="fast"))
    assert message in refusal(capsys, *arguments)


def test_descent_into_a_hand(capsys, shared_data, tmp_path):
    """Into the cortex of a metacarpal of the local CT volume, through the command line."""
    file = shared_data / "volumes" / "hand_ct.nrrd"
    if not file.is_file():
        pytest.skip(f"no {file}")
    pytest.importorskip("SimpleITK")
    figure = tmp_path / "hand.png"
    sunk = result(
        capsys, "descend", "--force", 0.5, "--volume", file, "--map", "90:180", "--entry", "65,50,103", "--axis",
        "0,1,0", "--seed", 1, "--plot", figure,
    )  # fmt: skip
    assert sunk["status"] == "ok"
    # Faster than in a half-space, because the burr wets less of a narrow bone.
    assert 0.0785 < sunk["penetration_velocity_mm_s"] < 0.4
    assert any("coarse" in text for text in sunk["warnings"])
    assert figure.stat().st_size > 10_000


def test_negative_coordinates(capsys):
    made = result(capsys, "descend", "--force", 1, "--voxel", 0.4, "--seed", 1, "--ideal", "--axis", "-1,0,0")
    assert made["provenance"]["axis"] == [-1.0, 0.0, 0.0]


def test_an_interrupted_run_exits_130(capsys, monkeypatch):
    import burrlab.descent.descent as module

    hold = module.hold
    monkeypatch.setattr(module, "hold", lambda *arguments: hold(*arguments[:-1], lambda _: True))
    words = ("descend", "--force", 0.3, "--voxel", 0.4, "--ideal", "--seed", 1)
    assert "interrupted" in said(capsys, *words, status=130)


AT_AN_IMPORT = """
import os, signal, sys
class At:
    left = int(sys.argv[1])
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        cls.left -= 1
        if cls.left == 0:
            os.kill(os.getpid(), signal.SIGINT)
sys.argv[:], sys.meta_path[:0] = ["burrlab", "session", "--device", "hand", "--voxel", "0.5"], [At]
from burrlab.cli import main
sys.exit(main())
"""


@pytest.mark.parametrize("modules", [3, 150, 400])
def test_ctrl_c_while_modules_load_is_no_traceback(modules):
    """Ctrl-C comes at the n-th import, the first of which is the package."""
    program = [sys.executable, "-c", AT_AN_IMPORT, str(modules)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 130
    assert len([line for line in done.stderr.splitlines() if "coarse" not in line]) <= 1
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("told", [["--shape", "f.csv"], ["--shape=f.csv"], ["--store", "f.csv", "--seed", 1]])
def test_what_a_sweep_reads_is_not_lost(told, capsys, here):
    profile = "x,f\n0,1\n0.5,0.8\n1,0\n"
    Path("f.csv").write_text(profile)
    sentence = refusal(capsys, "sweep", *told, "--forces", "1", "--voxel", 0.4, "--out", "./f.csv")
    assert sentence == "burrlab sweep: --out: ./f.csv is read, and would be lost\n"
    assert Path("f.csv").read_text() == profile


def test_an_interrupted_sweep_goes_on(capsys, tmp_path, monkeypatch):
    import burrlab.common.study as module

    command = [
        "sweep", "--forces", "1,2", "--repeats", 2, "--voxel", 0.4, "--out", tmp_path / "c.csv", "--store",
        tmp_path / "s.jsonl", "--seed",
    ]  # fmt: skip
    keep = module.Study._keep

    def stop(study, i, row):
        keep(study, i, row)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(module.Study, "_keep", stop)
        assert "interrupted, the same command goes on from" in said(capsys, *command, 5, status=130)
    assert "4 descents, 4 with a velocity" in said(capsys, *command, 5)
    assert len(burrlab.Store(tmp_path / "s.jsonl")) == 4
    assert "seed must be given with a store" in refusal(capsys, *command[:-1])


@pytest.fixture
def files(tmp_path):
    burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    burrlab.synthetic_curve(burr, bone, [0.3, 0.6, 1.2], seed=1).to_csv(tmp_path / "a.csv")
    burrlab.synthetic_curve(burr, bone, [0.8, 2.0, 2.6], seed=2).to_csv(tmp_path / "b.csv")
    burrlab.synthetic_indentation(burr, bone, [0.1, 0.2, 0.3], seed=1).to_csv(tmp_path / "i.csv")
    burrlab.synthetic_trace(burr, bone, 1.0, seed=1).to_csv(tmp_path / "t.csv")
    return tmp_path


def test_several_sets(capsys, files):
    names = [files / name for name in ("a.csv", "b.csv")]
    code, out, err = call(
        capsys, "fit", *names, "--indentation", files / "i.csv", "--trace", files / "t.csv", "--radius", 3,
        "--test", "2.145,0.087", "--region", files / "r.png", "--profile", files / "p.png", "--json", files / "fit.json",
    )  # fmt: skip
    fitted = json.loads((files / "fit.json").read_text())
    assert (code, err) == (0, "")
    assert "(2.145 N/mm^2, 0.087 /ms) lies" in out
    assert [one["kind"] for one in fitted["data"]] == ["velocity", "velocity", "indentation", "trace"]
    assert fitted["separately_identified"] is True
    assert fitted["verdict"].startswith("c_e and alpha are separately identified")
    assert 0 <= fitted["test"]["p_value"] <= 1
    for name in ("r.png", "p.png"):
        assert (files / name).stat().st_size > 10_000


def test_voxel_engine_and_store(capsys, files):
    burrlab.synthetic_curve(
        burrlab.Burr(3.0), burrlab.materials["pvc"], [0.2, 0.35, 0.6], repeats=1, seed=1
    ).to_csv(files / "v.csv")
    command = (
        "fit", files / "v.csv", "--radius", 3, "--engine", "voxel", "--voxel", 0.4, "--store", files / "s",
        "--seed", 0,
    )  # fmt: skip
    first = result(capsys, *command)
    assert first["engine"] == "voxel"
    n = len(burrlab.Store(files / "s"))
    assert n == 12 * len(first["record"])
    assert result(capsys, *command)["c_e"] == first["c_e"]
    assert len(burrlab.Store(files / "s")) == n
