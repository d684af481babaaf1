"""The command view: its files, and its refusals of one sentence."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from command_line import call, refusal, result
from session_scenes import small_bone
from view_scenes import carve, frames_in, need_drawing, read, recorded_trace  # noqa: F401

import burrlab.cli.view as cli_view
from burrlab import (
    Volume,
    VoxelBone,
    export_volumetric_drilling,
    load_trace,
    save_bone,
    write_volume,
)
from burrlab.effects.effects import effects_of
from burrlab.session.player import TracePlayer

SMALL = ("--size", "320x240")


@pytest.fixture(scope="module")
def volume(tmp_path_factory):
    """8 x 6 x 4 mm of grey 1000 under air, at 0.5 mm, turned by a quarter about z."""
    pytest.importorskip("SimpleITK")
    grey = np.full((8, 12, 16), 1000, np.int16)
    grey[6:] = -1000
    turned = [(0, -1, 0), (1, 0, 0), (0, 0, 1)]
    file = tmp_path_factory.mktemp("view") / "grey.nrrd"
    write_volume(file, Volume(grey, (0.5, 0.5, 0.5), (10.0, 20.0, 30.0), turned, "made"))
    return file


def test_pictures_need_no_extra(trace, tmp_path):
    """In a process that cannot import pyvista. Drawing a scene is refused in one sentence."""
    made, depth = tmp_path / "slices.png", tmp_path / "slices-depth.png"
    program = f"""
import sys
sys.modules["pyvista"] = None
from burrlab.cli import main
assert main(["view", {str(trace)!r}, "--pictures", {str(made)!r}, "--json", "-"]) == 0
sys.exit(main(["view", {str(trace)!r}, "--png", {str(tmp_path / "a.png")!r}]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.stderr == "burrlab view: the view needs pyvista: pip install 'burrlab[viz3d]'\n"
    assert done.returncode == 2
    assert json.loads(done.stdout)["written"] == [str(made), str(depth)]
    assert read(made).shape == (780, 1920, 3)
    assert read(depth).shape[1] > 800


def test_pictures_of_a_volume_are_in_the_bone_frame(volume, tmp_path, capsys):
    made = tmp_path / "slices.png"
    told = result(
        capsys, "view", "--volume", volume, "--map", "-1000:1000", "--pictures", made, "--entry", "9,21,32"
    )
    assert told["written"] == [str(made)]  # nothing removed: no depth
    assert read(made).shape == (780, 1920, 3)


def test_pictures_of_a_trace_go_through_the_entry(trace, tmp_path, capsys, monkeypatch):
    through = []
    monkeypatch.setattr(
        cli_view, "_write_pictures", lambda path, bone, point, note, **_: through.append(point) or []
    )
    for look in ((), ("--entry", "1,1,-1")):
        assert call(capsys, "view", trace, "--pictures", tmp_path / "a.png", *look)[0] == 0
    assert (tuple(through[0]), through[1]) == (
        tuple(load_trace(trace).ticks["burr"]["center_mm"][-1, 0]),
        (1, 1, -1),
    )


def test_effects_have_dust_and_water(trace, capsys, monkeypatch):
    served = {}
    monkeypatch.setattr(cli_view, "serve", lambda source, **options: served.update(options))
    assert call(capsys, "view", trace, "--web", "--effects")[0] == 0
    list(effects_of(TracePlayer(load_trace(trace)), served["effects"]))
    balance = served["effects"].balance()
    assert balance["dust"].made > 0
    assert balance["water"].made > 0


def test_what_does_not_go_together_is_refused(trace, volume, tmp_path, capsys):
    png = tmp_path / "a.png"
    for said, *arguments in (
        ("view needs one of TRACE, --bone FILE, and --volume or --labels FILE",),
        ("view needs one of TRACE, --bone FILE, and --volume or --labels FILE", trace, "--bone", trace),
        ("--effects goes with a trace", "--bone", trace, "--web", "--effects"),
        ("--at goes with a trace", "--bone", trace, "--at", 0),
        ("--video goes with a trace", "--volume", volume, "--video", "a.mp4"),
        ("--map goes with --volume or --labels", trace, "--map", "0:1"),
        ("--voxel goes with --volume or --labels", "--bone", trace, "--voxel", 1),
        ("--onto goes with --labels", trace, "--onto"),
        ("--volume needs --map", "--volume", volume),
        ("--port goes with --web", trace, "--port", 8080),
        ("--png goes without --web", trace, "--web", "--png", png),
        ("--axis goes with --entry", trace, "--axis", "0,0,-1"),
        ("--at goes without --web", trace, "--web", "--at", 0),
        ("--slices goes without --web", trace, "--web", "--slices"),
        ("--fps goes with --video", trace, "--png", png, "--fps", 5),
        ("--speed goes with --video", trace, "--pictures", png, "--speed", 2),
        ("--stereo does not go with --pictures alone", trace, "--pictures", png, "--stereo"),
        ("--at goes with a window, --png or --pictures: a film shows the whole "
         "trace", trace, "--video", "a.gif", "--at", 0),
        ("--width does not go with --pictures alone", trace, "--pictures", png, "--width", 5),
        ("--size does not go with --pictures alone", trace, "--pictures", png, "--size", "320x240"),
        ("--slices does not go with --pictures alone", trace, "--pictures", png, "--slices"),
        ("--png: a.jpg must end in .png", trace, "--png", "a.jpg"),
        ("a film must end in .mp4 or .gif, got a.avi", trace, "--video", "a.avi"),
        (f"--png: {tmp_path}/no/a.png cannot be written", trace, "--png", f"{tmp_path}/no/a.png"),
        (f"--pictures: {tmp_path} cannot be written", trace, "--pictures", tmp_path),
        (f"--json: {trace} is read, and would be lost", trace, "--png", png, "--json", trace),
        ("fps must be from 1 to 50 for .gif, got 60", trace, "--video", tmp_path / "a.gif", "--fps", 60),
        ("fps must be from 1 to 240 for .mp4, got 1e+06", trace, "--video", tmp_path / "a.mp4", "--fps", 1e6),
        ("--png must be another file than --pictures, got "
         "a.png", trace, "--pictures", "a.png", "--png", "a.png"),
        ("--png must be another file than the depth map of --pictures, got a-depth.png",
         trace, "--pictures", "./a.png", "--png", "a-depth.png"),
        ("entry lies 950 mm outside the bone, more than it is wide", trace, "--png", png, "--entry=0,0,950"),
    ):  # fmt: skip
        assert refusal(capsys, "view", *arguments) == f"burrlab view: {said}\n"
    assert not png.exists()


def test_bad_values_and_files(trace, here, capsys):
    (here / "ct.nrrd").write_text("NRRD0004\n")
    (here / "broken.h5").write_bytes(trace.read_bytes()[:1000])
    no_trace = "; --volume shows a volume, --bone a bone that was kept"
    for said, *arguments in (
        ("burrlab view: --pictures: - must end in one of ", trace, "--pictures", "-"),  # not a file
        ("must be WIDTHxHEIGHT of 16 to 16384 pixels, got '8x8'", trace, "--size", "8x8"),
        ("burrlab view: --pictures: a.xyz must end in one of ", trace, "--pictures", "a.xyz"),
        ("unknown option --pict; did you mean '--pictures'?", trace, "--pict", "a.png"),
        ("--at must be from 0 to 0.", trace, "--pictures", "a.png", "--at", 99),
        (no_trace, here, "--pictures", "a.png"), (no_trace, "ct.nrrd", "--pictures", "a.png"),
        ("", "broken.h5", "--pictures", "b.png"), ("", "--bone", "broken.h5", "--pictures", "b.png"),
        ("", "none.h5", "--pictures", "b.png"),
    ):  # fmt: skip
        assert said in refusal(capsys, "view", *arguments)
    assert {file.name for file in here.iterdir()} == {"ct.nrrd", "broken.h5"}


@pytest.fixture(scope="module")
def recording(trace):
    """The trace as the other simulator would have recorded it, and --bone with its bone."""
    found, file = load_trace(trace), trace.with_name("there.hdf5")
    export_volumetric_drilling(found, file)
    save_bone(trace.with_name("whole.h5"), found.bone(), 0)
    return file, "--bone", trace.with_name("whole.h5")


def test_pictures_of_a_recording(recording, tmp_path, capsys):
    made, other = tmp_path / "a.png", tmp_path / "other.h5"
    told = result(capsys, "view", *recording, "--at", 0.3, "--pictures", made)
    assert (told["at_s"], told["written"]) == (0.3, [str(made), str(tmp_path / "a-depth.png")])
    assert told["notes"][-1] == "not recorded: penetration, whether the burr turned"
    save_bone(other, VoxelBone.block((4, 4, 4), 0.5), 0)
    for said, *arguments in (
        ("there.hdf5 is a recording without bone: it needs either --bone FILE, or --volume", recording[0]),
        ("is a recording without bone: it needs either", *recording, "--volume", other),
        ("--effects goes with a trace, not with a recording", *recording, "--effects", "--web"),
        ("bone must have voxels of 0.008 mm^3, as the recording's", recording[0], "--bone", other),
        ("--at must be from 0 to 0.4", *recording, "--at", 1),
    ):
        code, _, err = call(capsys, "view", *arguments)
        assert (code, said in err.splitlines()[-1]) == (2, True)


def test_a_window_without_a_screen_is_one_sentence(trace, capsys, monkeypatch):
    pytest.importorskip("pyvista")
    if not sys.platform.startswith("linux"):
        pytest.skip("other systems have a screen")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    said = "a window needs a screen and there is none: draw to a file (--png, --video) or a page (--web)"
    assert refusal(capsys, "view", trace) == f"burrlab view: {said}\n"


@pytest.mark.slow
def test_picture_film_and_stereo_of_a_trace(trace, recording, tmp_path, capsys):
    need_drawing()
    png, stereo, film = tmp_path / "a.png", tmp_path / "b.png", tmp_path / "c.gif"
    assert call(capsys, "view", trace, "--png", png, "--at", 0.2, *SMALL)[0] == 0
    assert call(capsys, "view", trace, "--png", stereo, "--stereo", "--slices", *SMALL)[0] == 0
    assert read(png).shape == (240, 320, 3)
    wet = tmp_path / "wet.png"
    assert call(capsys, "view", trace, "--png", wet, "--at", 0.2, "--effects", *SMALL)[0] == 0
    assert (np.abs(read(wet).astype(int) - read(png)).max(axis=2) > 8).sum() > 20
    assert read(stereo).shape == (240, 640, 3)
    both, alone = tmp_path / "both.png", tmp_path / "alone.png"
    told = result(
        capsys,
        "view",
        trace,
        "--video",
        film,
        "--fps",
        10,
        "--speed",
        0.5,
        "--pictures",
        both,
        "--at",
        0,
        *SMALL,
    )
    assert call(capsys, "view", trace, "--pictures", alone, "--at", 0)[0] == 0
    np.testing.assert_array_equal(read(both), read(alone))
    frames = int(load_trace(trace).duration * 10 / 0.5 + 1e-9) + 1
    assert told["frames"] == frames_in(film) == frames
    assert result(capsys, "view", *recording, "--video", film, "--fps", 10, *SMALL)["frames"] == 5
    assert frames_in(film) == 5


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_a_film_that_is_killed_leaves_no_file(trace, tmp_path, name):
    program = f"""
import itertools, sys
from types import SimpleNamespace
import numpy as np
from burrlab.cli import main, view

class Endless:
    def __init__(self, player, **settings):
        self.scene = SimpleNamespace(look=print, close=print)

    def frames(self, **settings):
        for k in itertools.count():
            print(k, flush=True)
            yield np.zeros((16, 16, 3), np.uint8)

view.TraceView = Endless
sys.exit(main(["view", {str(trace)!r}, "--video", {str(tmp_path / "a.gif")!r}]))
"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as film:
        try:
            assert film.stdout.readline() == b"0\n"
            assert [file.suffixes[-2:] for file in tmp_path.iterdir()] == [[".part", ".gif"]]
            film.send_signal(getattr(signal, name))
            film.communicate(timeout=60)
        finally:
            film.kill()
        assert film.returncode == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_picture_of_bone_and_volume(volume, tmp_path, capsys):
    need_drawing()
    file = tmp_path / "bone.h5"
    save_bone(file, small_bone(), 0)
    pictures = []
    for i, look in enumerate(((), ("--entry", "0,0,0", "--axis", "0,0,-1", "--width", 8, "--slices"))):
        png = tmp_path / f"{i}.png"
        assert call(capsys, "view", "--bone", file, "--png", png, *look, *SMALL)[0] == 0
        pictures.append(read(png))
    assert pictures[0].shape == pictures[1].shape == (240, 320, 3)
    assert (pictures[0] != pictures[1]).any()
    png = tmp_path / "v.png"
    look = ("--entry", "8,22,32.5", "--axis", "0,0,-1", "--width", 8)
    assert (
        call(capsys, "view", "--volume", volume, "--map", "-1000:1000", "--png", png, *look, *SMALL)[0] == 0
    )
    # bone at the entry, which is in the volume's own coordinates
    assert read(png)[120, 160].astype(int).min() > 90


@pytest.mark.slow
def test_missing_libraries_are_one_sentence(trace, tmp_path):
    """With a loader that finds neither EGL nor OSMesa."""
    program = (
        "import ctypes.util, sys; ctypes.util.find_library = lambda name: None\n"
        "from burrlab.cli import main\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    left_out = {"DISPLAY", "WAYLAND_DISPLAY", "VTK_DEFAULT_OPENGL_WINDOW"}
    done = subprocess.run(
        [sys.executable, "-c", program, "view", str(trace), "--png", str(tmp_path / "a.png")],
        capture_output=True, text=True, check=False,
        env={name: text for name, text in os.environ.items() if name not in left_out},
    )  # fmt: skip
    sentence = "burrlab view: drawing without a screen needs the Debian packages libegl1"
    assert (done.returncode, done.stderr[: len(sentence)], done.stderr.count("\n")) == (2, sentence, 1)


def test_depth_is_mapped_along_the_axis_that_shows_the_opening():
    for start, axis in (((10, 10, 8.5), "-z"), ((-0.5, 10, 4), "x"), ((10, 20.5, 4), "-y")):
        bone = VoxelBone.block((20, 20, 8), 0.5)
        carve(bone, start, radius=2.5)
        assert bone.removed > 0
        assert cli_view._widest_opening(bone) == axis


def test_a_narrow_depth_map_leaves_no_empty_half(tmp_path):
    bone = VoxelBone.block((20, 20, 8), 0.5)
    carve(bone, *((10, y, 8.5) for y in np.linspace(3, 17, 400)), radius=2.5, ticks=1)
    cli_view._write_pictures(str(tmp_path / "a.png"), bone, (10, 10, 7), "")
    picture = read(tmp_path / "a-depth.png")
    assert np.flatnonzero((picture[..., :3] < 250).any(axis=(0, 2)))[0] < 0.1 * picture.shape[1]
