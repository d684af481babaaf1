"""What the surgeon sees, from the command line: burrlab view."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from burrlab.cli import Options, _deliver, _number, _positive
from burrlab.cli_session import _port
from burrlab.cli_trace import AddCommand
from burrlab.cli_volume import grey_map, vector

_OF_TRACE = ("at", "video", "web")


def add_view_command(command: AddCommand) -> None:
    """Adds `view` to the parser of `burrlab`."""
    view = command(
        "view", _view, "Show a recorded session, a bone or a volume: window, PNG, film or web page."
    )
    view.add_argument("file", metavar="TRACE", nargs="?", help="a trace")
    view.add_argument("--bone", metavar="FILE", help="a saved bone (HDF5) instead of a trace")
    view.add_argument("--volume", metavar="FILE", help="a grey volume instead of a trace")
    view.add_argument("--map", type=grey_map, metavar="LO:HI", help="grey values of empty and solid")
    view.add_argument("--at", type=_number, metavar="S", help="time of the trace [s], default its end")
    view.add_argument("--png", metavar="FILE", help="write a picture; no window opens")
    view.add_argument("--pictures", metavar="FILE", help="write slices and, if bone was removed, FILE-depth, by matplotlib alone")  # fmt: skip
    view.add_argument("--video", metavar="FILE", help="write a film, .mp4 or .gif; no window opens")
    view.add_argument("--fps", type=_positive, default=20.0, help="of the film [1/s], default 20")
    view.add_argument("--speed", type=_positive, default=1.0, help="of the trace in the film, default 1")
    view.add_argument("--stereo", action="store_true", help="both eyes' pictures side by side")
    view.add_argument("--slices", action="store_true", help="slices through the burr, or the middle")
    view.add_argument(
        "--size", type=_size, default=(1024, 768), metavar="WxH", help="[pixel], default 1024x768"
    )
    view.add_argument("--entry", type=vector, metavar="X,Y,Z", help="what is looked at, bone frame [mm]")
    view.add_argument("--axis", type=vector, metavar="X,Y,Z", help="direction of the approach, into the bone")
    view.add_argument("--width", type=_positive, metavar="MM", help="that the view holds at the entry [mm]")
    view.add_argument("--web", action="store_true", help="serve a page for a browser instead of a window")
    view.add_argument("--port", type=_port, help="of the page, default any free one")
    view.add_argument("--effects", action="store_true", help="dust, blood and water in the page, at assumed rates")  # fmt: skip
    view.add_argument("--json", metavar="FILE", help="write the result as JSON; - for standard output")


def _size(text: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdecimal() for part in parts) or min(map(int, parts)) < 16:
        raise argparse.ArgumentTypeError(f"must be WIDTHxHEIGHT of at least 16 pixels, got '{text}'")
    return int(parts[0]), int(parts[1])


def _view(options: Options) -> int:
    _check(options)
    if options.web:
        return _serve(options)
    return _show_trace(options) if options.file is not None else _show_bone(options)


def _serve(options: Options) -> int:
    from burrlab.session.trace import load_trace
    from burrlab.view.camera import surgeon_view
    from burrlab.view.web import check_page, serve

    check_page(port=options.port or 0)
    trace = load_trace(options.file)
    effects = viewpoint = None
    if options.effects:
        from burrlab.effects import Effects

        effects = Effects(trace.bone(), seed=trace.seed)
    if options.entry is not None or options.width is not None:
        viewpoint = surgeon_view(trace.bone(), options.entry, options.axis, width=options.width)
    serve(trace, port=options.port or 0, size=options.size, effects=effects, viewpoint=viewpoint)
    return 0


def _check(options: Options) -> None:
    """ValueError before any work for what does not go together, or could not be written."""
    given = [name for name in ("file", "bone", "volume") if getattr(options, name) is not None]
    if len(given) != 1:
        raise ValueError("view needs one of TRACE, --bone FILE and --volume FILE")
    if options.file is None:
        for name in _OF_TRACE:
            if getattr(options, name):
                raise ValueError(f"--{name} goes with a trace")
    if (options.volume is None) != (options.map is None):
        raise ValueError("--volume and --map go together")
    for name in ("port", "effects"):
        if getattr(options, name) and not options.web:
            raise ValueError(f"--{name} goes with --web")
    if options.axis is not None and options.entry is None:
        raise ValueError("--axis goes with --entry")
    for name in ("png", "pictures", "video"):
        path = getattr(options, name)
        if path is None:
            continue
        folder = Path(path).resolve().parent
        if not folder.is_dir() or not os.access(folder, os.W_OK) or Path(path).is_dir():
            raise ValueError(f"--{name}: {path} cannot be written")
    if options.video is not None and Path(options.video).suffix.lower() not in (".mp4", ".gif"):
        raise ValueError(f"--video: {options.video} must end in .mp4 or .gif")
    if options.png is not None and Path(options.png).suffix.lower() != ".png":
        raise ValueError(f"--png: {options.png} must end in .png")


def _scene_options(options: Options) -> dict[str, Any]:
    return {"size": options.size, "off_screen": options.png is not None or options.video is not None}


def _needs_scene(options: Options) -> bool:
    return options.png is not None or options.video is not None or options.pictures is None


def _look(options: Options, scene: Any) -> None:
    if options.entry is not None or options.width is not None:
        from burrlab.view.camera import surgeon_view

        scene.look(surgeon_view(scene.bone, options.entry, options.axis, width=options.width))


def _show_trace(options: Options) -> int:
    from burrlab.session.trace import load_trace
    from burrlab.view.player import TracePlayer

    player = TracePlayer(load_trace(options.file))
    at = player.duration if options.at is None else options.at
    result: dict[str, Any] = {"file": str(options.file), "at_s": at, "written": []}
    if _needs_scene(options):
        from burrlab.view.trace_view import TraceView
        from burrlab.view.video import write_video

        view = TraceView(player, slices=options.slices, **_scene_options(options))
        _look(options, view.scene)
        if options.video is not None:
            frames = view.frames(fps=options.fps, speed=options.speed, stereo=options.stereo)
            result["frames"] = write_video(options.video, frames, fps=options.fps)
            result["written"].append(str(options.video))
        view.go(at)
        _finish_scene(options, view.scene, result)
    else:
        player.seek(at)
    if options.pictures is not None:
        centers = player.burrs.centers
        point = centers[0] if len(centers) else None
        _write_pictures(options.pictures, player.bone, point, player.burrs.radii.tolist(), centers, result)
    return _done(options, result)


def _show_bone(options: Options) -> int:
    if options.bone is not None:
        from burrlab.session.snapshot import load_bone

        bone, _ = load_bone(options.bone)
    else:
        from burrlab.volume import VolumeRecipe

        bone = VolumeRecipe(options.volume, options.map).bone()
    middle = [
        o + s * (n - 1) / 2 for o, s, n in zip(bone.origin, bone.spacing, bone.shape[::-1], strict=True)
    ]
    point = options.entry or middle
    result: dict[str, Any] = {"file": str(options.bone or options.volume), "written": []}
    if _needs_scene(options):
        from burrlab.view.scene import Scene

        scene = Scene(bone, [], **_scene_options(options))
        _look(options, scene)
        if options.slices:
            scene.set_slices(point)
        _finish_scene(options, scene, result)
    if options.pictures is not None:
        _write_pictures(options.pictures, bone, point, [], [], result)
    return _done(options, result)


def _finish_scene(options: Options, scene: Any, result: dict[str, Any]) -> None:
    if options.png is not None:
        (scene.stereo_pair if options.stereo else scene.screenshot)(options.png)
        result["written"].append(str(options.png))
    elif options.video is None:
        scene.show()
    scene.close()


def _write_pictures(
    path: str, bone: Any, point: Any, radii: list[float], centers: Any, result: dict[str, Any]
) -> None:
    from matplotlib.figure import Figure

    from burrlab.figures import new_figure
    from burrlab.view.pictures import plot_depth_map, plot_slices

    figure = Figure(figsize=(9.6, 3.9), layout="constrained")
    plot_slices(bone, point, radii=radii, centers=centers, figure=figure)
    figure.savefig(path, dpi=200)
    result["written"].append(str(path))
    if bone.removed > 0:
        depth, file = new_figure(), Path(path)
        plot_depth_map(bone, ax=depth.subplots())
        depth.savefig(file.with_stem(f"{file.stem}-depth"), dpi=200)
        result["written"].append(str(file.with_stem(f"{file.stem}-depth")))


def _done(options: Options, result: dict[str, Any]) -> int:
    _deliver(options, result, "".join(f"written {path}\n" for path in result["written"]).rstrip() or "closed")
    return 0
