"""The command line's contract."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

import burrlab
from burrlab.cli import main


def call(capsys, *arguments):
    try:
        code = main([str(a) for a in arguments])
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    return code, out, err


def test_descend_prints_one_json_object(capsys):
    code, out, _ = call(
        capsys, "descend", "--material", "bone", "--force", 1.0, "--radius", 3, "--voxel", 0.2, "--dt", 1, "--seed", 1,
        "--json", "-",
    )  # fmt: skip
    result = json.loads(out)
    assert code == 0
    assert {
        "status", "penetration_velocity_mm_s", "window_mm", "force_N", "duration_s", "seed", "version"
    } <= set(result)  # fmt: skip
    assert result["status"] == "ok"
    assert result["version"] == burrlab.__version__
    assert result["seed"] == 1


def test_a_run_without_a_number_exits_0_with_its_status(capsys):
    code, out, _ = call(
        capsys, "descend", "--force", 5, "--voxel", 0.4, "--ideal", "--seed", 1, "--json", "-"
    )
    result = json.loads(out)
    assert code == 0
    assert result["status"] == "overloaded"
    assert result["penetration_velocity_mm_s"] is None


def test_overrides_and_figure(capsys, tmp_path):
    figure, file = tmp_path / "run.png", tmp_path / "run.json"
    code, out, _ = call(
        capsys, "descend", "--force", 1.0, "--c-e", 1.5, "--alpha", 0.1, "--shape", "quartic", "--voxel", 0.4, "--ideal",
        "--seed", 2, "--plot", figure, "--json", file,
    )  # fmt: skip
    assert code == 0
    assert "mm/s" in out
    assert figure.stat().st_size > 10_000
    made = json.loads(file.read_text())["material"]
    assert (made["c_e"], made["alpha"], made["shape"]) == (1.5, 0.1, "quartic")


def test_sweep_then_fit(capsys, tmp_path):
    file, figure = tmp_path / "curve.csv", tmp_path / "fit.png"
    code, _, _ = call(
        capsys, "sweep", "--material", "bone", "--forces", "0.8:2.4:4", "--repeats", 2, "--voxel", 0.4, "--seed", 3,
        "--out", file, "--json", "-",
    )  # fmt: skip
    assert code == 0
    code, out, _ = call(capsys, "fit", file, "--radius", 3, "--json", "-", "--plot", figure)
    result = json.loads(out)
    assert code == 0
    assert {
        "c_e", "alpha", "shape", "radius_mm", "residual", "chi2_reduced", "n_points", "status", "version"
    } <= set(result)  # fmt: skip
    assert result["chi2_reduced"] is None
    assert result["n_points"] == 8
    assert result["c_e"] == pytest.approx(2.145, rel=0.1)
    assert figure.stat().st_size > 10_000


def test_materials_and_version(capsys):
    code, out, _ = call(capsys, "materials", "--json", "-")
    table = json.loads(out)
    assert code == 0
    assert table["bone"]["c_e"] == 2.145
    assert "unknown" in table["bone"]["source"]
    assert call(capsys, "version")[1] == f"burrlab {burrlab.__version__}\n"


@pytest.mark.parametrize("command", ["descend", "sweep", "fit", "materials", "version"])
def test_help(capsys, command):
    code, out, _ = call(capsys, command, "--help")
    assert code == 0
    assert "usage:" in out


CSV = "force_N,velocity_mm_s\n1.0,0.5\n1.2,{cell}\n1.4,0.9\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "empty"),
        ("force_N\n1.0\n", "velocity_mm_s"),
        (CSV.format(cell="fast"), "line 3"),
        (CSV.format(cell="-0.4"), "line 3"),
        ("force_N,velocity_mm_s\n1,0.5\n1,0.6\n1.2,0.7\n", "three"),
    ],
)
def test_wrong_csv_exits_2_with_one_line(capsys, tmp_path, content, message):
    file = tmp_path / "data.csv"
    file.write_text(content)
    code, out, err = call(capsys, "fit", file, "--radius", 3)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert message in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["descend"], "--force"),
        (["descend", "--force", "-1"], "--force: must be positive"),
        (["descend", "--force", "1", "--radius", "0"], "--radius: must be positive"),
        (["descend", "--force", "1", "--dt", "-1"], "--dt: must be positive"),
        (["descend", "--force", "25"], "force must be within the rig's range"),
        (["descend", "--force", "1", "--shape", "round"], "--shape"),
        (["descend", "--force", "1", "--volume", "none.nrrd"], "--volume needs --map and --entry and --axis"),
        (["descend", "--force", "1", "--map", "1:2"], "--map goes with --volume"),
        (["descend", "--force", "1", "--map", "2:1"], "LO below HI"),
        (["descend", "--force", "1", "--axis", "1,2"], "--axis: must be X,Y,Z"),
        (["descend", "--force", "1", "--seed", "x"], "--seed"),
        (["sweep", "--forces", "1:2", "--out", "x.csv"], "--forces: must be FIRST:LAST:COUNT"),
        (["fit", "none.csv", "--radius", "3"], "none.csv"),
        (["fit", "none.csv", "--test", "2.1"], "--test: must be C_E,ALPHA"),
        (["fit", "none.csv", "--store", "s.jsonl"], "--store goes with --engine voxel"),
        (["fit", "--indentation", "i.csv"], "a fit needs velocities"),
    ],
)
def test_wrong_options_exit_2_with_one_line(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    code, out, err = call(capsys, *arguments)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert message in err


def test_installed_command_runs():
    run = subprocess.run(
        [sys.executable, "-m", "burrlab", "version"],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert run.stdout.startswith("burrlab ")


def test_descent_into_a_hand(capsys, shared_data, tmp_path):
    """Into the cortex of a metacarpal of the local CT volume, through the command line."""
    file = shared_data / "volumes" / "hand_ct.nrrd"
    if not file.is_file():
        pytest.skip(f"no {file}")
    pytest.importorskip("SimpleITK")
    figure = tmp_path / "hand.png"
    code, out, _ = call(
        capsys, "descend", "--force", 0.5, "--volume", file, "--map", "90:180", "--entry", "65,50,103", "--axis",
        "0,1,0", "--seed", 1, "--json", "-", "--plot", figure,
    )  # fmt: skip
    result = json.loads(out)
    assert code == 0
    assert result["status"] == "ok"
    # A narrow bone: faster than a half-space, for the burr wets less of it.
    assert 0.0785 < result["penetration_velocity_mm_s"] < 0.4
    assert any("coarse" in text for text in result["warnings"])
    assert figure.stat().st_size > 10_000


@pytest.mark.parametrize("option", ["--json", "--plot"])
def test_an_output_that_cannot_be_written_is_said_before_the_work(capsys, tmp_path, option):
    code, _, err = call(
        capsys, "descend", "--force", 0.2, "--voxel", 0.05, option, tmp_path / "none" / "x.png"
    )
    assert code == 2
    assert f"{option}: " in err
    assert "cannot be written" in err


def test_a_figure_of_unknown_kind_is_refused(capsys, tmp_path):
    code, _, err = call(capsys, "descend", "--force", 1, "--plot", tmp_path / "x.xyz")
    assert code == 2
    assert "must end in one of" in err


def test_negative_coordinates(capsys):
    code, out, _ = call(
        capsys,
        "descend",
        "--force",
        1,
        "--voxel",
        0.4,
        "--seed",
        1,
        "--ideal",
        "--axis",
        "-1,0,0",
        "--json",
        "-",
    )
    assert code == 0
    assert json.loads(out)["provenance"]["axis"] == [-1.0, 0.0, 0.0]


def test_an_interrupted_run_exits_130(capsys, monkeypatch):
    import burrlab.descent.descent as module

    monkeypatch.setattr(module.Watch, "interrupted", lambda *_: True)
    code, out, _ = call(capsys, "descend", "--force", 0.3, "--voxel", 0.4, "--ideal", "--seed", 1)
    assert code == 130
    assert "interrupted" in out


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


@pytest.mark.parametrize("modules", [3, 30, 150, 400, 800])
def test_ctrl_c_while_modules_load_is_no_traceback(modules):
    """In the importing of so many modules, the first of which is the package itself."""
    program = [sys.executable, "-c", AT_AN_IMPORT, str(modules)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 130
    assert len([line for line in done.stderr.splitlines() if "coarse" not in line]) <= 1
    assert "Traceback" not in done.stderr


def test_warnings_and_seed_are_printed(capsys):
    _, out, _ = call(capsys, "descend", "--force", 1, "--voxel", 0.6, "--ideal", "--seed", 9)
    assert "coarse" in out
    assert "seed 9" in out


def test_an_interrupted_sweep_goes_on(capsys, tmp_path, monkeypatch):
    import burrlab.study as module

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
        code, out, _ = call(capsys, *command, 5)
    assert code == 130
    assert "interrupted, the same command goes on from" in out
    whole = burrlab.force_sweep(
        burrlab.Burr(3.0), burrlab.materials["bone"], [1.0, 2.0], repeats=2, voxel=0.4, seed=5
    )
    code, out, _ = call(capsys, *command, 5)
    assert code == 0
    assert list(burrlab.VelocityCurve.from_csv(tmp_path / "c.csv").velocity) == list(whole.velocity)
    size = (tmp_path / "s.jsonl").stat().st_size
    assert call(capsys, *command, 5)[0] == 0
    assert (tmp_path / "s.jsonl").stat().st_size == size, "all of it was there"
    code, _, err = call(capsys, *command[:-1])
    assert code == 2
    assert "seed must be given with a store" in err


class TestFitOptions:
    @pytest.fixture
    def files(self, tmp_path):
        burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
        burrlab.synthetic_curve(burr, bone, [0.3, 0.6, 1.2], seed=1).to_csv(tmp_path / "a.csv")
        burrlab.synthetic_curve(burr, bone, [0.8, 2.0, 2.6], seed=2).to_csv(tmp_path / "b.csv")
        burrlab.synthetic_indentation(burr, bone, [0.1, 0.2, 0.3], seed=1).to_csv(tmp_path / "i.csv")
        burrlab.synthetic_trace(burr, bone, 1.0, seed=1).to_csv(tmp_path / "t.csv")
        return tmp_path

    def test_several_sets(self, capsys, files):
        names = [files / name for name in ("a.csv", "b.csv")]
        code, out, err = call(
            capsys, "fit", *names, "--indentation", files / "i.csv", "--trace", files / "t.csv", "--radius", 3,
            "--test", "2.145,0.087", "--region", files / "r.png", "--profile", files / "p.png", "--json", "-",
        )  # fmt: skip
        result = json.loads(out)
        assert (code, err) == (0, "")
        assert [one["kind"] for one in result["data"]] == ["velocity", "velocity", "indentation", "trace"]
        assert result["separately_identified"] is True
        assert result["verdict"].startswith("c_e and alpha are separately identified")
        assert set(result["intervals"]) == {"c_e", "alpha"}
        assert set(result["identified"]) == {"exponent", "value", "interval"}
        assert 0 <= result["test"]["p_value"] <= 1
        for name in ("r.png", "p.png"):
            assert (files / name).stat().st_size > 10_000

    def test_open_ends_are_null(self, capsys, files):
        bone = burrlab.materials["bone"]
        burrlab.synthetic_curve(burrlab.Burr(3.0), bone, [0.3, 0.4, 0.5], seed=1).to_csv(files / "ridge.csv")
        code, out, _ = call(capsys, "fit", files / "ridge.csv", "--radius", 3, "--json", "-")
        result = json.loads(out)
        assert code == 0
        assert result["intervals"]["c_e"]["95"][1] is None
        assert result["separately_identified"] is False
        assert "no upper end" in result["verdict"]

    def test_the_test_is_in_the_report(self, capsys, files):
        code, out, _ = call(
            capsys, "fit", files / "a.csv", files / "b.csv", "--radius", 3, "--test", "2.145,0.087"
        )
        assert code == 0
        assert "(2.145 N/mm^2, 0.087 /ms) lies" in out

    def test_voxel_engine_and_store(self, capsys, files):
        pvc = burrlab.materials["pvc"]
        burrlab.synthetic_curve(burrlab.Burr(3.0), pvc, [0.2, 0.35, 0.6], repeats=1, seed=1).to_csv(
            files / "v.csv"
        )
        command = (
            "fit",
            files / "v.csv",
            "--radius",
            3,
            "--engine",
            "voxel",
            "--voxel",
            0.4,
            "--store",
            files / "s",
        )
        code, out, err = call(capsys, *command, "--json", "-")
        assert (code, err) == (0, "")
        first = json.loads(out)
        assert first["engine"] == "voxel"
        n = len(burrlab.Store(files / "s"))
        assert n == 12 * len(first["record"])
        assert json.loads(call(capsys, *command, "--json", "-")[1])["c_e"] == first["c_e"]
        assert len(burrlab.Store(files / "s")) == n

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (["--test", "2.1"], "must be C_E,ALPHA"),
            (["--test", "2.1,-1"], "must be positive"),
            (["--indentation", "missing.csv"], "missing.csv"),
            (["--trace", "missing.csv"], "missing.csv"),
            (["--region", "figure.xyz"], "must end in one of"),
            (["--profile", "/nowhere/p.png"], "cannot be written"),
            (["--residuals", "sigma"], "need a sigma"),
            (["--engine", "oracle"], "invalid choice"),
        ],
    )
    def test_errors_are_one_line(self, capsys, files, options, message):
        code, out, err = call(capsys, "fit", files / "a.csv", "--radius", 3, *options)
        assert (code, out) == (2, "")
        assert err.count("\n") == 1
        assert message in err

    def test_a_store_of_something_else(self, capsys, files):
        (files / "s").write_text("no store\n")
        store = ("--engine", "voxel", "--store", files / "s")
        code, _, err = call(capsys, "fit", files / "a.csv", "--radius", 3, *store)
        assert code == 2
        assert "store must be a file of burrlab results" in err
