"""Publishing a session, and following it with a replica on another machine (docs/network.md)."""

import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from burrlab._core import AnatomyWatch, Burr, Follower, Material, Publisher, Replica, VoxelBone
from burrlab.anatomy.watch import Watch
from burrlab.bone.materials import constants_of
from burrlab.bone.recipe import block_recipe, make_bone, volume_recipe, whole_number
from burrlab.common.check import refuse, scalar, whole
from burrlab.common.records import UNREADABLE, check_texts, in_one_line
from burrlab.session.settings import Publish
from burrlab.session.trace import json_text, tool_of

__all__ = ["block_recipe", "follow", "make_bone", "open_publisher", "volume_recipe"]

_NEEDED = ("seed", "rate_Hz", "scheme", "tools")  # of a hello


def open_publisher(
    follower: Follower, hello: Mapping[str, Any], publish: Publish, **options: Any
) -> Publisher:
    """A publisher for a follower that has not started.

    Parameters
    ----------
    follower : Follower
    hello : mapping
        Data for replicas: seed, rate_Hz, scheme, tools (radius_mm, material, c_e_N_per_mm2, alpha_per_ms,
        shape, and the exponents of a law that is not the paper's), and source, the bone's recipe. The provenance of a session holds them. Of a file in the recipe
        only its name is sent.
    publish : Publish
    options
        Of `Publisher`: its log, and when it drops a peer.

    Raises
    ------
    ValueError
        If the hello is incomplete or not JSON, the address cannot be listened on, or a setting is out of
        range.
    """
    for name in _NEEDED:
        refuse(name not in hello, f"hello must hold {', '.join(_NEEDED)}, got none of {name}")
    text = json_text("hello", hello, default=str)
    return Publisher(follower, hello=_without_folders(text), **asdict(publish), **options)


def _without_folders(hello: str) -> str:
    """A hello without the folders of the recipe's files: any peer can ask for it, and they can name a patient."""
    folders: set[str] = set()

    def keep_folders(part: dict[str, Any]) -> dict[str, Any]:
        folders.update(
            os.path.join(os.path.dirname(part[key]), "")
            for key in ("path", "labels")
            if isinstance(part.get(key), str)
        )
        return part

    json.loads(hello, object_hook=keep_folders)
    for folder in sorted(folders - {"", os.sep}, key=len, reverse=True):  # in notes, too
        hello = hello.replace(json.dumps(folder)[1:-1], "")
    return hello


def follow(
    host: str,
    port: int,
    *,
    bone: VoxelBone | None = None,
    volume: str | os.PathLike[str] | None = None,
    timeout: float = 10.0,
) -> Replica:
    """A started replica of a published session.

    Parameters
    ----------
    host : str
    port : int
        Port of the leader.
    bone : VoxelBone, optional
        The leader's initial volume; it is copied. Default: made by the leader's recipe.
    volume : path, optional
        Path of the recipe's volume on this machine. Default: a file of its name in the working directory.
    timeout : float
        Time for the leader to answer [s].

    Returns
    -------
    Replica
        `wait`, `status`, `digest`, `snapshot` and `take` tell its state; `stop` ends it.

    Raises
    ------
    ConnectionError
        If no leader answers.
    ValueError
        If the timeout is not positive, the address cannot be looked up, the leader's hello cannot be read or
        has no recipe of the bone, or the bone here is not the leader's.
    FileNotFoundError
        If the volume is not here.
    """
    port, timeout = whole("port", port, 2**16, "2^16"), scalar(timeout, "timeout")
    refuse(not timeout > 0, f"timeout must be positive, got {timeout!r}")
    replica = Replica(host, port)
    until = time.monotonic() + timeout
    while not replica.fetch_hello(0.5):
        refuse(time.monotonic() >= until, f"no leader answers at {host}:{port}", ConnectionError)
    try:
        hello = json.loads(replica.hello)
        tools = [_tool(tool) for tool in hello["tools"]]
        seed, scheme = whole_number(hello["seed"], 2**64 - 1), hello["scheme"]
        period = 1e3 / float(hello["rate_Hz"])
        recipe = dict(hello.get("source") or {})
        refuse(scheme not in ("layer", "cell"), "scheme must be layer or cell")
        if bone is None:  # file names, which error messages quote
            check_texts(recipe)
            check_texts(json.loads(recipe.get("tissues", "null")))  # JSON in a text
    except UNREADABLE as error:
        raise ValueError(
            f"hello of the leader at {host}:{port} cannot be read: {in_one_line(repr(error))}"
        ) from None
    refuse(
        bone is None and not recipe,
        f"bone must be given: the leader at {host}:{port} does not say how its own was made",
    )
    copy = make_bone(recipe, volume=volume) if bone is None else bone.copy()
    if copy.tissues is not None:  # a hello does not say where a material's values are from
        known = copy.tissues.material
        tools = [
            (b, known if (m.name, constants_of(m)) == (known.name, constants_of(known)) else m)
            for b, m in tools
        ]
    replica.start(
        copy, tools, seed, period=period, scheme=scheme, watch=_watch(copy, hello.get("watch"), tools)
    )
    return replica


def _watch(bone: VoxelBone, settings: Any, tools: Sequence[tuple[Burr, Material]]) -> AnatomyWatch | None:
    """The leader's watch on the bone here; None if the leader has none."""
    if not settings or bone.tissues is None:
        return None
    try:
        return Watch.of_settings(bone, settings).core([burr.radius for burr, _ in tools])
    except UNREADABLE as error:
        raise ValueError(f"watch of the leader cannot be set up here: {in_one_line(error)}") from None


def _tool(tool: Mapping[str, Any]) -> tuple[Burr, Material]:
    name = str(tool["material"])
    refuse(not name.isprintable(), f"material must have a name that can be printed, got {name!r}")
    return tool_of(tool, name, "from the leader of a session")
