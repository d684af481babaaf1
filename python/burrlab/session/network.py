"""Two machines: publishing a session, and a replica that holds the same bone (docs/network.md)."""

from __future__ import annotations

import json
import math
import os
import reprlib
import time
from collections.abc import Mapping, Sequence
from typing import Any

from burrlab._core import AnatomyWatch, Burr, Follower, Material, Publisher, Replica, VoxelBone
from burrlab.arguments import real, whole
from burrlab.json_text import UNREADABLE as _UNREADABLE
from burrlab.json_text import check_texts, in_one_line
from burrlab.specimen import MOST_VOXELS
from burrlab.volume.cut import cut_block
from burrlab.volume.drilled_recipe import DrilledRecipe
from burrlab.volume.occupancy_map import OccupancyMap, occupancy_map
from burrlab.volume.recipe import VolumeRecipe

#: How a bone is made; JSON.
Recipe = dict[str, Any]

_NEEDED = ("seed", "rate_Hz", "scheme", "tools")  # of a hello


def block_recipe(
    size: Sequence[float], voxel: float, *, origin: Sequence[float] = (0.0, 0.0, 0.0), level: int = 255
) -> Recipe:
    """The recipe of `VoxelBone.block`.

    Parameters
    ----------
    size : (x, y, z)
        [mm]
    voxel : float
        [mm]
    origin : (x, y, z)
        Centre of the first voxel [mm].
    level : int
        0 to 255.

    Examples
    --------
    >>> recipe = block_recipe((2, 2, 1), 0.1)
    >>> make_bone(recipe).shape
    (10, 20, 20)
    """
    return {"kind": "block", "size_mm": [float(real(s, "size")) for s in size], "voxel_mm": float(real(voxel, "voxel")),
            "origin_mm": [float(real(o, "origin")) for o in origin], "level": int(level)}  # fmt: skip


def volume_recipe(
    path: str | os.PathLike[str],
    mapping: OccupancyMap | float,
    solid: float | None = None,
    *,
    spacing: float | Sequence[float] | None = None,
    series: str | None = None,
    crop: tuple[Sequence[float], Sequence[float]] | None = None,
    voxel: float | Sequence[float] | None = None,
    transpose: bool | None = None,
) -> Recipe:
    """The recipe of `read_volume(path).to_bone(mapping, solid)`, cropped and resampled as asked.

    Parameters
    ----------
    path : path
        Made absolute, for replicas run elsewhere.
    mapping, solid
        As for `Volume.to_bone`.
    spacing, series, crop, voxel, transpose
        As for `burrlab.volume.VolumeRecipe`.

    Raises
    ------
    ValueError
        If a parameter is wrong; the file is not looked at.
    TypeError
        If the map is none.
    """
    chosen: Any = (spacing, series, crop, voxel, transpose)
    return VolumeRecipe(os.fspath(path), occupancy_map(mapping, solid), *chosen).plain()


def make_bone(recipe: Mapping[str, Any], *, volume: str | os.PathLike[str] | None = None) -> VoxelBone:
    """The bone of a recipe.

    Parameters
    ----------
    recipe : mapping
        Of `block_recipe`, `volume_recipe`, an experiment's `VolumeBlock`, `LabelledRecipe.plain` or `DrilledRecipe.plain`;
        it may come from another machine.
    volume : path, optional
        Where the volume lies here, if elsewhere.

    Raises
    ------
    ValueError
        If the recipe cannot be read, names a block too large to make, or the volume cannot be read.
    FileNotFoundError
        If there is no such volume.
    """
    try:
        if recipe["kind"] == "block":
            size, origin = _three(recipe["size_mm"]), _three(recipe["origin_mm"])
            voxel, level = float(recipe["voxel_mm"]), _whole(recipe["level"], 255)
        elif recipe["kind"] == "volume":
            made = VolumeRecipe.of(recipe)
        elif recipe["kind"] == "volume block":
            made, voxel = VolumeRecipe.of(recipe["volume"]), float(recipe["voxel_mm"])
            size, entry, axis = (_three(recipe[key]) for key in ("size_mm", "entry_mm", "axis"))
        elif recipe["kind"] == "labelled volume":
            from burrlab.anatomy.labelled_recipe import LabelledRecipe  # anatomy builds on sessions

            labelled = LabelledRecipe.of(recipe)
        elif recipe["kind"] == "drilled volume":
            drilled = DrilledRecipe.of(recipe)
        else:
            raise KeyError("kind")
    except _UNREADABLE:
        raise ValueError(
            f"recipe must be that of block_recipe or volume_recipe, got {reprlib.repr(recipe)}"
        ) from None
    if recipe["kind"] == "drilled volume":
        return (drilled if volume is None else drilled.at(volume)).bone()
    if recipe["kind"] == "labelled volume":
        return (labelled if volume is None else labelled.at(volume)).bone()
    if recipe["kind"] == "volume":
        return (made if volume is None else made.at(volume)).bone()
    if recipe["kind"] == "volume block":
        here = made if volume is None else made.at(volume)
        return cut_block(here, size, voxel, entry=entry, axis=axis)
    if voxel > 0 and not (voxels := math.prod(max(s / voxel, 1.0) for s in size)) <= MOST_VOXELS:
        raise ValueError(f"recipe must have at most {MOST_VOXELS:.3g} voxels, got {voxels:.3g}")
    return VoxelBone.block(size, voxel, origin=origin, level=level)


def open_publisher(
    follower: Follower,
    hello: Mapping[str, Any],
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    header_version: int = 1,
    **options: Any,
) -> Publisher:
    """A publisher of a follower that is not yet started.

    Parameters
    ----------
    follower : Follower
    hello : mapping
        What replicas need: seed, rate_Hz, scheme, tools (radius_mm, material, c_e_N_per_mm2, alpha_per_ms, shape), and
        source, the bone's recipe. The provenance of a session is one.
    host, port, header_version, options
        As for `Publisher`.

    Raises
    ------
    ValueError
        If the hello lacks something or is not JSON, nobody can listen there, or an option is out of range.
    """
    port = whole("port", port, 2**16, "2^16")
    for name in _NEEDED:
        if name not in hello:
            raise ValueError(f"hello must hold {', '.join(_NEEDED)}, got none of {name}")
    try:
        text = json.dumps(dict(hello), default=str, allow_nan=False)
    except ValueError as error:
        raise ValueError(f"hello must be what JSON holds: {error}") from None
    return Publisher(follower, host=host, port=port, hello=text, header_version=header_version, **options)


def follow(
    host: str,
    port: int,
    *,
    bone: VoxelBone | None = None,
    volume: str | os.PathLike[str] | None = None,
    timeout: float = 10.0,
) -> Replica:
    """A replica of a published session; it follows from now on.

    Parameters
    ----------
    host : str
    port : int
        Of the leader.
    bone : VoxelBone, optional
        Its initial volume, copied; without it made by the leader's recipe.
    volume : path, optional
        Where the volume of the leader's recipe lies on this machine, if elsewhere.
    timeout : float
        For the leader to answer [s].

    Returns
    -------
    Replica
        Its `wait`, `status`, `digest`, `snapshot` and `take` say how it goes; `stop` ends it.

    Raises
    ------
    ConnectionError
        If no leader answers.
    ValueError
        If the timeout is not positive, the address cannot be looked up, the leader's hello cannot be read or has no recipe of the bone, or the
        bone here is not the leader's.
    FileNotFoundError
        If the volume is not here.
    """
    port, timeout = whole("port", port, 2**16, "2^16"), float(real(timeout, "timeout"))
    if not timeout > 0:
        raise ValueError(f"timeout must be positive, got {timeout!r}")
    replica = Replica(host, port)
    until = time.monotonic() + timeout
    while not replica.fetch_hello(0.5):
        if time.monotonic() >= until:
            raise ConnectionError(f"no leader answers at {host}:{port}")
    try:
        hello = json.loads(replica.hello)
        tools = [_tool(tool) for tool in hello["tools"]]
        seed, scheme = _whole(hello["seed"], 2**64 - 1), hello["scheme"]
        period = 1e3 / float(hello["rate_Hz"])
        recipe = dict(hello.get("source") or {})
        if scheme not in ("layer", "cell"):
            raise ValueError("scheme must be layer or cell")
        if bone is None:  # names of files, which refusals quote
            check_texts(recipe)
    except _UNREADABLE as error:
        raise ValueError(
            f"hello of the leader at {host}:{port} cannot be read: {in_one_line(repr(error))}"
        ) from None
    if bone is None and not recipe:
        raise ValueError(f"bone must be given: the leader at {host}:{port} does not say how its own was made")
    mine = make_bone(recipe, volume=volume) if bone is None else bone.copy()
    if mine.tissues is not None:  # a hello does not say where a material's values are from
        known = mine.tissues.material
        tools = [(burr, known if _same(known, material) else material) for burr, material in tools]
    watch = _watch(mine, hello.get("watch"), tools)
    replica.start(mine, tools, seed, period=period, scheme=scheme, watch=watch)
    return replica


def _watch(bone: VoxelBone, settings: Any, tools: Sequence[tuple[Burr, Material]]) -> AnatomyWatch | None:
    """The leader's watch on the bone here; None where it has none."""
    if not settings or bone.tissues is None:
        return None
    from burrlab.anatomy.watch import Watch

    try:
        return Watch.of_settings(bone, settings).core([burr.radius for burr, _ in tools])
    except _UNREADABLE as error:
        raise ValueError(f"watch of the leader cannot be set up here: {in_one_line(error)}") from None


def _tool(tool: Mapping[str, Any]) -> tuple[Burr, Material]:
    if not (name := str(tool["material"])).isprintable():
        raise ValueError(f"material must have a name that can be printed, got {name!r}")
    material = Material(
        name, c_e=float(tool["c_e_N_per_mm2"]), alpha=float(tool["alpha_per_ms"]),
        shape=str(tool["shape"]), source="from the leader of a session",
    )  # fmt: skip
    return Burr(float(tool["radius_mm"])), material


def _same(one: Material, other: Material) -> bool:
    return (one.name, one.c_e, one.alpha, one.shape) == (other.name, other.c_e, other.alpha, other.shape)


def _three(numbers: Sequence[Any]) -> list[float]:
    x, y, z = map(float, numbers)
    return [x, y, z]


def _whole(number: Any, most: int) -> int:
    if not 0 <= int(number) <= most or int(number) != number:
        raise ValueError(number)
    return int(number)
