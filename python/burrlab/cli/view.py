"""Views of bones, volumes and traces on the command line: burrlab view."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from burrlab._core import Nozzle, VoxelBone
from burrlab.bone.header import assumed
from burrlab.bone.materials import materials
from burrlab.bone.recipe import DrilledRecipe
from burrlab.bone.snapshot import holds_bone
from burrlab.cli.bone import OF_LABELS, chosen_recipe, say_notes
from burrlab.cli.commands import FPS
from burrlab.cli.options import (
    Options,
    deliver,
    ended_by_signals,
    on_terminal,
    refuse_options,
    save_figure,
    say,
    sentence,
)
from burrlab.common.check import refuse
from burrlab.common.figures import new_figure
from burrlab.common.files import new_file
from burrlab.effects.effects import Effects
from burrlab.foreign.volumetric_drilling import is_recording, read_volumetric_drilling
from burrlab.session.player import Player, RecordingPlayer, TracePlayer
from burrlab.session.trace import load_trace
from burrlab.view.camera import Viewpoint, approach_view, surgeon_view, trace_approach
from burrlab.view.film import TraceView, check_film, write_video
from burrlab.view.pictures import depth_map, plot_depth_map, plot_slices
from burrlab.view.scene import SIZE, Scene
from burrlab.view.web import serve


def do_view(options: Options) -> None:
    _check(options)
    player: Player | None = None
    if options.file is None:
        bone, notes, _ = _chosen_bone(options)
        at = 0.0
        result: dict[str, Any] = {"file": str(options.bone or options.volume or options.labels)}
    else:
        player, notes = _player(options)
        bone = player.bone
        at = player.duration if options.at is None else options.at
        result = {"file": str(options.file), "at_s": at}
    note, effects = assumed(notes), None
    if isinstance(player, TracePlayer) and options.effects:
        effects = Effects(player.trace.bone(), seed=player.trace.seed, nozzle=Nozzle())
    if options.web:
        return serve(
            player or bone, port=options.port or 0, size=options.size or (1024, 768), effects=effects,
            viewpoint=_viewpoint(options, bone, player), stereo=bool(options.stereo), note=note,
        )  # fmt: skip
    if player is not None:
        refuse(not 0 <= at <= player.duration, f"--at must be from 0 to {player.duration:g} s, got {at:g}")
    result.update(written=[], notes=notes)
    middle = [
        o + s * (n - 1) / 2 for o, s, n in zip(bone.origin, bone.spacing, bone.shape[::-1], strict=True)
    ]
    if _needs_scene(options):
        _draw(options, bone, player, at, effects, note, middle, result)
    elif player is not None:
        player.seek(at, progress=on_terminal())
    if options.pictures is not None:
        result["written"] += _draw_pictures(options, bone, player, at, note, middle)
    deliver(options, result, "".join(f"written {path}\n" for path in result["written"]).rstrip() or "closed")


def _draw(
    options: Options, bone: VoxelBone, player: Player | None, at: float, effects: Effects | None, note: str,
    middle: Sequence[float], result: dict[str, Any],
) -> None:  # fmt: skip
    """Makes the film and the picture that are asked for, or shows a window, of the bone as it was at a moment."""
    window = options.png is None and options.video is None
    both = window and bool(options.stereo)  # files have two whole pictures
    settings: dict[str, Any] = {
        "size": options.size or (SIZE if both else (1024, 768)), "off_screen": not window, "stereo": both, "note": note,
    }  # fmt: skip
    if player is None:
        scene = Scene(bone, [], **settings)
        if options.slices:
            scene.set_slices(options.entry or middle)
    else:
        view = TraceView(
            player, effects=effects, slices=bool(options.slices), progress=on_terminal(), **settings
        )
        scene = view.scene
    if (viewpoint := _viewpoint(options, bone, player)) is not None:
        scene.look(viewpoint)
    if options.video is not None:
        fps = options.fps or FPS
        frames = view.frames(
            fps=fps, speed=options.speed or 1.0, stereo=bool(options.stereo), progress=on_terminal()
        )
        with ended_by_signals():
            result["frames"] = write_video(options.video, frames, fps=fps)
        result["written"].append(str(options.video))
    if player is not None and (options.video is None or options.png or options.pictures):
        view.go(at, progress=on_terminal())
    if options.png is not None:
        (scene.stereo_pair if options.stereo else scene.screenshot)(options.png)
        result["written"].append(str(options.png))
    if window:
        scene.show()
    scene.close()


def _draw_pictures(
    options: Options, bone: VoxelBone, player: Player | None, at: float, note: str, middle: Sequence[float]
) -> list[str]:
    """Slices through the burr, once it is known, and depth maps; returns the files."""
    centers = np.zeros((0, 3)) if player is None else player.burrs.centers
    known = player is not None and len(centers) > 0 and bool(np.isfinite(centers).all())
    burrs = {"radii": player.burrs.radii.tolist(), "centers": centers} if player and known else {}
    point = options.entry or (centers[0] if known else middle)
    note = note if player is None else f"{note}, at {at:.2f} s" if note else f"at {at:.2f} s"
    return _write_pictures(options.pictures, bone, point, note, **burrs)


def _check(options: Options) -> None:
    """ValueError for options that exclude one another and files that could not be written."""
    of_volume = options.volume is not None or options.labels is not None
    recorded = options.file is not None and is_recording(options.file)
    refuse(
        (options.file is not None and not recorded) + (options.bone is not None) + of_volume != 1,
        f"{options.file} is a recording without bone: it needs either --bone FILE, or --volume or --labels FILE"
        if recorded
        else "view needs one of TRACE, --bone FILE, and --volume or --labels FILE",
    )
    film_alone = options.video is not None and not (options.png or options.pictures)
    for applies, names, why in (
        (options.file is None, ("at", "video", "effects"), "goes with a trace"),
        (recorded, ("effects",), "goes with a trace, not with a recording"),
        (not recorded, ("scale",), "goes with a recording of volumetric_drilling"),
        (
            not of_volume, ("map", "spacing", "series", "crop", "voxel", "transpose"),
            "goes with --volume or --labels",
        ),
        (not of_volume, OF_LABELS, "goes with --labels"),
        (options.web, ("png", "pictures", "video", "at", "slices"), "goes without --web"),
        (not options.web, ("port",), "goes with --web"),
        (options.entry is None, ("axis",), "goes with --entry"),
        (options.video is None, ("fps", "speed"), "goes with --video"),
        (film_alone, ("at",), "goes with a window, --png or --pictures: a film shows the whole trace"),
        (
            not _needs_scene(options), ("width", "axis", "size", "slices", "effects", "stereo"),
            "does not go with --pictures alone",
        ),
    ):  # fmt: skip
        refuse_options(options, names, why, applies)
    if options.video is not None:
        check_film(Path(options.video), options.fps or FPS)
    refuse(
        options.png is not None and Path(options.png).suffix.lower() != ".png",
        f"--png: {options.png} must end in .png",
    )
    for name in ("png", "json") if options.pictures is not None else ():
        path = getattr(options, name)
        refuse(
            path is not None and Path(path).resolve() == _depth_file(options.pictures).resolve(),
            f"--{name} must be another file than the depth map of --pictures, got {path}",
        )


def _needs_scene(options: Options) -> bool:
    return options.png is not None or options.video is not None or options.pictures is None


def _viewpoint(options: Options, bone: VoxelBone, player: Player | None) -> Viewpoint | None:
    """The viewpoint that the options ask for, in the bone frame; None if they ask for none."""
    if options.entry is not None:
        return surgeon_view(bone, options.entry, options.axis, width=options.width)
    if options.width is None:
        return None
    return approach_view(bone, None if player is None else trace_approach(player), width=options.width)


def _player(options: Options) -> tuple[Player, list[str]]:
    """The player of the trace, or of the recording and its bone, and the notes on it."""
    if is_recording(options.file):
        recording = read_volumetric_drilling(options.file, scale=options.scale or 1.0)
        bone, notes, source = _chosen_bone(options)
        shown = RecordingPlayer(recording, bone, source)
        say(shown.note)
        return shown, [*notes, shown.note]
    try:
        player = TracePlayer(load_trace(options.file))
        return player, list(player.trace.notes)
    except (ValueError, IsADirectoryError) as error:
        if isinstance(error, ValueError) and "is not a burrlab trace" not in str(error):
            raise
        raise ValueError(f"{sentence(error)}; --volume shows a volume, --bone a bone that was kept") from None


def _chosen_bone(options: Options) -> tuple[VoxelBone, list[str], dict[str, Any]]:
    """The bone of --bone, --volume or --labels, the assumptions about it, and its source; brings entry and axis
    into the bone frame."""
    recipe = (
        chosen_recipe(options, materials["bone"]) if options.bone is None else DrilledRecipe(options.bone)
    )
    assert recipe is not None
    bone = recipe.bone()
    if options.entry is not None and not holds_bone(options.bone or ""):
        grid = recipe.grid()
        options.entry = tuple(grid.bone_point(options.entry).tolist())
        if options.axis is not None:
            options.axis = tuple((grid.direction.T @ np.asarray(options.axis)).tolist())
    say_notes(recipe)
    return bone, list(recipe.notes()), recipe.plain()


def _write_pictures(path: str, bone: VoxelBone, point: Any, note: str, **burrs: Any) -> list[str]:
    """Writes slices, and a depth map if bone was removed; returns the files."""
    written, slices = [str(path)], plot_slices(bone, point, note=note, **burrs)
    save_figure(slices[0], path)
    if bone.removed > 0:
        depth, file = new_figure(), _depth_file(path)
        plot_depth_map(bone, axis=_widest_opening(bone), note=note, ax=depth.subplots())
        with new_file(file, file.suffix) as part:
            depth.savefig(part, dpi=200, bbox_inches="tight")  # a cavity may be narrow
        written.append(str(file))
    return written


def _depth_file(pictures: str) -> Path:
    """The file of the depth map beside that of the slices."""
    return Path(pictures).with_stem(f"{Path(pictures).stem}-depth")


def _widest_opening(bone: VoxelBone) -> str:
    """The viewing direction, of six, along which the opening is widest; the first of equal ones."""
    area = {"xyz"[k]: bone.spacing[k - 2] * bone.spacing[k - 1] for k in range(3)}
    return max(
        ("-z", "z", "x", "-x", "y", "-y"),
        key=lambda axis: np.count_nonzero(depth_map(bone, axis=axis) > 0) * area[axis[-1]],
    )
