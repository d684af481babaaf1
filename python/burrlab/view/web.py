"""A replay, a running session or a bone in a web page, drawn on the server: the browser needs no WebGL."""

import asyncio
import contextlib
import ipaddress
import os
import secrets
import signal
import socket
import sys
import uuid
from collections.abc import Callable, Iterator
from typing import Any

from burrlab.common.check import extra, refuse
from burrlab.effects.companion import Companion
from burrlab.effects.effects import Effects
from burrlab.view.camera import Viewpoint
from burrlab.view.page import Page, build_layout, restrict
from burrlab.view.page_source import PageSource, Shown, page_source
from burrlab.view.scene import Scene

_LOOPBACK = {"localhost", "127.0.0.1", "::1"}


def serve(
    source: Shown,
    *,
    effects: Effects | Companion | None = None,
    host: str = "127.0.0.1",
    port: int = 0,
    size: tuple[int, int] = (1024, 768),
    level: int = 128,
    viewpoint: Viewpoint | None = None,
    stereo: bool = False,
    note: str = "",
    on_ready: Callable[[str], object] | None = None,
) -> None:
    """Serves a page until Ctrl-C or SIGTERM.

    The address holds a secret, which is drawn anew each time. Those who have the address can see and work the
    page; all others get nothing. By default only this machine can reach it. The page loads nothing from
    elsewhere.

    Parameters
    ----------
    source : Trace, TracePlayer, RecordingPlayer, Session, Replica or VoxelBone
        A trace or a recording is replayed, with a time line; a session or a started replica is shown live,
        and goes on when the page ends; a bone does not change.
    effects : Effects or Companion, optional
        Dust, blood and water. For a trace: effects of its initial bone, made in the background. For a session
        or a replica: a companion that runs beside it.
    host : str
        Address to listen on.
    port : int
        0 for any free one.
    size : (width, height)
        Size of the picture until a browser tells its own [pixel].
    level : int
        Occupancy level at the bone's surface, 1 to 255.
    viewpoint : Viewpoint, optional
        The first camera; default: for a trace, along the forces that the burr met, else from above.
    stereo : bool
        Begin with both eyes side by side; the page has a switch for it.
    note : str
        A few words on the bone, above the scale bar; default: the assumptions in the notes of a trace, a
        session or a replica.
    on_ready : callable, optional
        Called with the page's address; default: it is printed.

    Raises
    ------
    TypeError
        If the source is of another kind, or the effects do not go with it.
    ValueError
        If the port is not from 0 to 65535, or size or level is out of range.
    OSError
        If the port is taken, the address is not one of this machine, or no library draws without a screen.
    ImportError
        If pyvista or trame is not installed.
    RuntimeError
        If an event loop runs already.
    """
    page = page_source(source, effects)
    refuse(not 0 <= port <= 65535, f"port must be from 0 to 65535, got {port!r}")
    check_page(host=host, port=port)
    asyncio.run(_serve(
        page, host, port, viewpoint, stereo, on_ready,
        size=size, level=level, note=note or page.note, outline=page.kind == "replay",
    ))  # fmt: skip


def check_page(*, host: str = "127.0.0.1", port: int = 0) -> None:
    """ImportError without trame, OSError if the port cannot be had, RuntimeError if an event loop runs."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        pass
    else:
        raise RuntimeError(
            "serve blocks until the page ends, and an event loop runs here: use a script or a terminal"
        )
    for module in ("trame.ui.vuetify3", "trame.widgets.vuetify3"):
        extra(module, "the page", "viz3d")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise OSError(f"cannot listen on {host}:{port}: {error.strerror or error}") from None


def warning(address: str) -> str:
    """A page's address with a warning of who can use it."""
    return (
        f"{address}  (keep it to yourself: whoever has this address can see and work the page; Ctrl-C ends)"
    )


async def _serve(
    source: PageSource, host: str, port: int, viewpoint: Viewpoint | None, stereo: bool,
    on_ready: Callable[[str], object] | None, **settings: Any,
) -> None:  # fmt: skip
    scene = Scene(source.bone, source.radii, off_screen=True, chart=False, **settings)
    try:
        server = _server()
        page = Page(server, source, scene, surgeon=viewpoint, stereo=stereo)
        build_layout(page)
        secret, end = secrets.token_hex(16), asyncio.Event()  # lower case, as trame needs it
        server.controller.on_server_bind.add(lambda web: _prepare(web, server.protocol, host, secret))
        ready = server.ready
        with _on_its_own(end):
            task = server.start(
                host=host, port=port, exec_mode="task", thread=True, open_browser=False, show_connection_info=False, timeout=0,
            )  # fmt: skip
            await asyncio.wait([ready, task], return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                task.result()
            address = f"http://{_named(host, server.port)}/{secret}/"
            if on_ready is None:
                print(warning(address), flush=True)
            else:
                on_ready(address)
            source.open()
            work = asyncio.create_task(page.run())
            await end.wait()
            work.cancel()
            await server.stop()
    finally:
        source.close()
        scene.close()


def _server() -> Any:
    from trame.app import get_server

    os.environ["WSLINK_READY_MSG"] = ""  # else it prints a word
    os.environ.setdefault("WSLINK_WS_COMPRESS", "0")  # pictures are compressed already
    return get_server(f"burrlab-{uuid.uuid4()}", client_type="vue3")


def _prepare(web: Any, protocol: Any, host: str, secret: str) -> None:
    """Serves only paths below the secret, only at the address listened on, and restricts the calls."""
    from aiohttp.web import HTTPBadRequest, HTTPForbidden, WebSocketResponse, json_response
    from yarl import URL

    resolve = web.app.router.resolve

    async def below(request: Any) -> Any:
        here, port = request.transport.get_extra_info("sockname")[:2]
        names = {here, host} | (_LOOPBACK if ipaddress.ip_address(here).is_loopback else set())
        hosts = {_named(name, port) for name in names}
        origin = request.headers.get("Origin")
        if request.host not in hosts or (origin and origin not in {f"http://{name}" for name in hosts}):
            raise HTTPForbidden(text="this is the page of another address")
        first, _, rest = request.rel_url.raw_path[1:].partition("/")
        if not secrets.compare_digest(first.encode(), secret.encode()):
            raise HTTPForbidden(text="the address lacks the secret that was printed with it")
        if rest == "ws" and not WebSocketResponse().can_prepare(request):  # on which its handler fails
            raise HTTPBadRequest(text="this address is for the page's WebSocket only")
        return await resolve(request.clone(rel_url=URL(f"/{rest}", encoded=True)))

    async def launch(request: Any) -> Any:
        """Answers trame's page as a launcher does, with the secret of its connection."""
        return json_response({"sessionURL": f"ws://{request.host}/{secret}/ws", "secret": secret})

    web.app.router.resolve = below
    web.app.router.add_post("/paraview/", launch)
    protocol.updateSecret(secret)  # replaces trame's own, which everybody knows
    for handler in web._ws_handlers:
        restrict(handler)


def _named(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


@contextlib.contextmanager
def _on_its_own(end: asyncio.Event) -> Iterator[None]:
    """Lets Ctrl-C and SIGTERM end the page in order, if this is the main thread, and hides the program's arguments,
    which trame would read as its own."""
    loop = asyncio.get_running_loop()
    with contextlib.ExitStack() as after:
        after.callback(setattr, sys, "argv", sys.argv)
        sys.argv = sys.argv[:1]
        for number in (signal.SIGINT, signal.SIGTERM):
            handler = signal.getsignal(number)
            # Event loops take no handlers on Windows, nor outside the main thread: there Ctrl-C stays as it is.
            with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
                loop.add_signal_handler(number, end.set)
                after.callback(signal.signal, number, handler)
                after.callback(loop.remove_signal_handler, number)
        yield
