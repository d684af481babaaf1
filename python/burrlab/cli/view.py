"""What the surgeon sees, from the command line: burrlab view."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from burrlab._core import Nozzle
from burrlab.bone.header import assumed, told_notes
from burrlab.bone.materials import materials
from burrlab.bone.recipe import DrilledRecipe
from burrlab.cli.options import (
    OF_LABELS,
    AddCommand,
    Options,
    Recipe,
    add_label_options,
    add_volume_options,
    chosen_recipe,
    deliver,
    number,
    port,
    positive,
    refuse_options,
    say_notes,
    sentence,
)
from burrlab.common.figures import new_figure
from burrlab.effects.effects import Effects
from burrlab.session.player import TracePlayer
from burrlab.session.trace import load_trace
from burrlab.view.camera import approach_view, surgeon_view, trace_approach
from burrlab.view.film import TraceView, check_film, write_video
from burrlab.view.pictures import depth_map, plot_depth_map, plot_slices
from burrlab.view.scene import SIZE, Scene
from burrlab.view.web import check_page, serve

_OF_TRACE = ("at", "video", "effects")
_OF_FILM = ("fps", "speed")
_OF_SCENE = ("width", "axis", "size", "slices", "effects", "stereo")  # --pictures has none
_FPS = 20.0  # of a film [1/s]
_OF_VOLUME = ("map", "spacing", "series", "crop", "voxel", "transpose")


def add_view_command(command: AddCommand) -> None:
    """Adds `view` to the parser of `burrlab`."""
    view = command(
        "view", _view, "Show a recorded session, a bone or a volume: window, PNG, film or web page."
    )
    view.add_argument(
        "file", metavar="TRACE", nargs="?", help="a trace; its --entry and --axis are in the bone frame"
    )
    view.add_argument(
        "--bone",
        metavar="FILE",
        help="a bone that was kept (.h5, or a volume with its state) instead of a trace",
    )
    view.add_argument("--at", type=number, metavar="S", help="time of the trace [s], default its end")
    view.add_argument("--png", metavar="FILE", help="write a picture; no window opens")
    view.add_argument(
        "--pictures",
        metavar="FILE",
        help="write slices and, if bone was removed, FILE-depth, by matplotlib alone",
    )
    view.add_argument(
        "--video", metavar="FILE", help="write a film of the trace, .mp4 or .gif; no window opens"
    )
    view.add_argument("--fps", type=positive, help=f"of the film [1/s], default {_FPS:g}")
    view.add_argument("--speed", type=positive, help="of the trace in the film, default 1")
    view.add_argument("--stereo", action="store_true", default=None, help="both eyes side by side")
    view.add_argument(
        "--slices",
        action="store_true",
        default=None,
        help="slices through the burr, the entry or the middle",
    )
    view.add_argument("--size", type=_size, metavar="WxH", help="[pixel], default 1024x768")
    view.add_argument("--width", type=positive, metavar="MM", help="that the view holds, top to bottom [mm]")
    view.add_argument("--web", action="store_true", help="serve a page for a browser instead of a window")
    view.add_argument("--port", type=port, help="of the page, default any free one")
    view.add_argument(
        "--effects",
        action="store_true",
        default=None,
        help="dust, blood and, from a nozzle beside the burr, water of a trace, at assumed rates",
    )
    view.add_argument("--voxel", type=positive, help="of a volume's bone [mm], default its own")
    add_volume_options(view)
    add_label_options(view)
    view.add_argument("--json", metavar="FILE", help="write the result as JSON; - for standard output")


def _size(text: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdecimal() for part in parts) or min(map(int, parts)) < 16:
        raise argparse.ArgumentTypeError(f"must be WIDTHxHEIGHT of at least 16 pixels, got '{text}'")
    return int(parts[0]), int(parts[1])


def _view(options: Options) -> int:
    _check(options)
    return _show_trace(options) if options.file is not None else _show_bone(options)


def _check(options: Options) -> None:
    """ValueError before any work for what does not go together, or could not be written."""
    of_volume = options.volume is not None or options.labels is not None
    if (options.file is not None) + (options.bone is not None) + of_volume != 1:
        raise ValueError("view needs one of TRACE, --bone FILE, and --volume or --labels FILE")
    if options.file is None:
        refuse_options(options, _OF_TRACE, "goes with a trace")
    if not of_volume:
        refuse_options(options, _OF_VOLUME, "goes with --volume or --labels")
        refuse_options(options, OF_LABELS, "goes with --labels")
    _check_shown(options)
    if options.video is not None:
        check_film(Path(options.video), options.fps or _FPS)
    if options.png is not None and Path(options.png).suffix.lower() != ".png":
        raise ValueError(f"--png: {options.png} must end in .png")
    if options.pictures is not None:
        depth = _depth_file(options.pictures)
        for name in ("png", "json"):
            path = getattr(options, name)
            if path is not None and Path(path).resolve() == depth.resolve():
                raise ValueError(
                    f"--{name} must be another file than the depth map of --pictures, got {path}"
                )


def _check_shown(options: Options) -> None:
    """ValueError for an option that what is asked for would not look at."""
    if options.web:
        refuse_options(options, ("png", "pictures", "video", "at", "slices"), "goes without --web")
    else:
        refuse_options(options, ("port",), "goes with --web")
    if options.entry is None:
        refuse_options(options, ("axis",), "goes with --entry")
    if options.video is None:
        refuse_options(options, _OF_FILM, "goes with --video")
    if options.at is not None and options.video is not None and not (options.png or options.pictures):
        raise ValueError("--at goes with a window, --png or --pictures: a film shows the whole trace")
    if not _needs_scene(options):
        refuse_options(options, _OF_SCENE, "does not go with --pictures alone")


def _scene_size(options: Options, *, both_eyes: bool = False) -> tuple[int, int]:
    return options.size or (SIZE if both_eyes else (1024, 768))


def _scene_options(options: Options) -> dict[str, Any]:
    window = options.png is None and options.video is None
    stereo = window and bool(options.stereo)  # files have two whole pictures
    return {"size": _scene_size(options, both_eyes=stereo), "off_screen": not window, "stereo": stereo}


def _needs_scene(options: Options) -> bool:
    return options.png is not None or options.video is not None or options.pictures is None


def _viewpoint(options: Options, bone: Any, player: Any = None) -> Any:
    """As asked for in the bone frame; None if not."""
    if options.entry is not None:
        return surgeon_view(bone, options.entry, options.axis, width=options.width)
    if options.width is None:
        return None
    return approach_view(bone, None if player is None else trace_approach(player), width=options.width)


def _look(options: Options, scene: Any, player: Any = None) -> None:
    viewpoint = _viewpoint(options, scene.bone, player)
    if viewpoint is not None:
        scene.look(viewpoint)


def _serve(
    options: Options, source: Any, bone: Any, player: Any = None, effects: Any = None, note: str = ""
) -> int:
    check_page(port=options.port or 0)
    viewpoint = _viewpoint(options, bone, player)
    serve(
        source, port=options.port or 0, size=_scene_size(options), effects=effects, viewpoint=viewpoint,
        stereo=bool(options.stereo), note=note,
    )  # fmt: skip
    return 0


def _show_trace(options: Options) -> int:
    try:
        trace = load_trace(options.file)
    except (ValueError, IsADirectoryError) as error:
        if isinstance(error, ValueError) and "is not a burrlab trace" not in str(error):
            raise
        raise ValueError(f"{sentence(error)}; --volume shows a volume, --bone a bone that was kept") from None
    effects = None
    if options.effects:
        effects = Effects(trace.bone(), seed=trace.seed, nozzle=Nozzle())
    player = TracePlayer(trace)
    if options.web:
        return _serve(options, player, player.bone, player, effects)
    at = player.duration if options.at is None else options.at
    if not 0 <= at <= player.duration:
        raise ValueError(f"--at must be from 0 to {player.duration:g} s, got {at:g}")
    notes = list(trace.notes)
    result: dict[str, Any] = {"file": str(options.file), "at_s": at, "written": [], "notes": notes}
    if _needs_scene(options):
        view = TraceView(player, effects=effects, slices=bool(options.slices), **_scene_options(options))
        _look(options, view.scene, player)
        if options.video is not None:
            fps = options.fps or _FPS
            frames = view.frames(fps=fps, speed=options.speed or 1.0, stereo=bool(options.stereo))
            result["frames"] = write_video(options.video, frames, fps=fps)
            result["written"].append(str(options.video))
        if options.video is None or options.png is not None or options.pictures is not None:
            view.go(at)
        _finish_scene(options, view.scene, result)
    else:
        player.seek(at)
    if options.pictures is not None:
        centers = player.burrs.centers
        known = len(centers) > 0 and bool(np.isfinite(centers).all())
        burrs = (player.burrs.radii.tolist(), centers) if known else ([], [])
        point = options.entry or (centers[0] if known else _middle(player.bone))
        _write_pictures(options.pictures, player.bone, point, *burrs, result)
    return _done(options, result)


def _show_bone(options: Options) -> int:
    recipe = _recipe(options)
    bone = recipe.bone()
    _into_bone_frame(options, recipe)
    say_notes(recipe)
    notes, file = list(recipe.notes()), str(options.bone or options.volume or options.labels)
    note = assumed(notes)
    if options.web:
        return _serve(options, bone, bone, note=note)
    point = _middle(bone) if options.entry is None else options.entry
    result: dict[str, Any] = {"file": file, "written": [], "notes": notes}
    if _needs_scene(options):
        scene = Scene(bone, [], note=note, **_scene_options(options))
        _look(options, scene)
        if options.slices:
            scene.set_slices(point)
        _finish_scene(options, scene, result)
    if options.pictures is not None:
        _write_pictures(options.pictures, bone, point, [], [], result)
    return _done(options, result)


def _recipe(options: Options) -> Recipe | DrilledRecipe:
    if options.bone is not None:
        return DrilledRecipe(options.bone)
    recipe = chosen_recipe(options, materials["bone"])
    assert recipe is not None
    return recipe


def _into_bone_frame(options: Options, recipe: Recipe | DrilledRecipe) -> None:
    """Entry and axis are given in the volume's own coordinates; those of a bone alone are the bone frame."""
    if options.entry is None or Path(options.bone or "").suffix.lower() in (".h5", ".hdf5"):
        return
    grid = recipe.like()
    options.entry = tuple(grid.bone_point(options.entry).tolist())
    if options.axis is not None:
        options.axis = tuple((grid.direction.T @ np.asarray(options.axis)).tolist())


def _middle(bone: Any) -> list[float]:
    """Of the volume, bone frame [mm]."""
    return [o + s * (n - 1) / 2 for o, s, n in zip(bone.origin, bone.spacing, bone.shape[::-1], strict=True)]


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

    figure, note = Figure(figsize=(9.6, 3.9), layout="constrained"), assumed(told_notes(result))
    plot_slices(bone, point, radii=radii, centers=centers, note=note, figure=figure)
    figure.savefig(path, dpi=200)
    result["written"].append(str(path))
    if bone.removed > 0:
        depth, file = new_figure(), _depth_file(path)
        plot_depth_map(bone, axis=_widest_opening(bone), note=note, ax=depth.subplots())
        depth.savefig(file, dpi=200, bbox_inches="tight")  # a cavity may be narrow
        result["written"].append(str(file))


def _depth_file(pictures: str) -> Path:
    """Where the depth map goes that is written beside the slices."""
    file = Path(pictures)
    return file.with_stem(f"{file.stem}-depth")


def _widest_opening(bone: Any) -> str:
    """The direction of looking, of six, in which most of the surface is seen to have gone; the first where several do."""
    area = dict(zip("xyz", (bone.spacing[k - 2] * bone.spacing[k - 1] for k in range(3)), strict=True))
    return max(
        ("-z", "z", "x", "-x", "y", "-y"),
        key=lambda axis: np.count_nonzero(depth_map(bone, axis=axis) > 0) * area[axis[-1]],
    )


def _done(options: Options, result: dict[str, Any]) -> int:
    deliver(options, result, "".join(f"written {path}\n" for path in result["written"]).rstrip() or "closed")
    return 0
