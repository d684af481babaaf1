"""Pages of sessions, replicas and effects, and their refusals, without a browser or a renderer."""

import asyncio
import socket
import sys
import threading
from unittest import mock

import numpy as np
import pytest
from anatomy_scenes import nerve_bone, straight, tool
from command_line import refusal
from page_scenes import PATH, make_page, make_scene, nerve_session, turn, watched_trace  # noqa: F401
from replica_scenes import soon
from session_scenes import refused

import burrlab
import burrlab.view.web as web
from burrlab.effects import Companion, Effects, effects_of
from burrlab.session.network import block_recipe, follow, make_bone
from burrlab.view.page import Page
from burrlab.view.page_source import ParcelHistory, page_source

BLOCK = block_recipe((8, 8, 4), 0.2, origin=(-3.9, -3.9, -3.9))


def test_beside_a_session_to_its_end():
    session = nerve_session()
    page = make_page(page_source(session))
    turn(page)
    said = {row["name"]: row["value"] for row in page.state.numbers}
    assert (said["centre"], said["force"], said["bone removed"]) == ("not known", "0.00", "0.00")
    assert page.state.source_state == "not started"
    with session:
        while session.running:
            turn(page)
        session.wait()  # the follower may be behind
        turn(page)
    final, ticks = session.snapshot()
    assert page.source.bone.digest() == final.digest()
    assert page.source.bone.removed == final.removed > 0
    assert (page.state.time_s, page.state.source_state) == (pytest.approx(ticks / 1000), session.reason)
    events = session.anatomy().events
    said = [tuple(row["text"].split(",")[0].split(" ")[::2]) for row in page.state.events]
    assert said == [(event.kind, event.structure) for event in events]
    assert [row["time_s"] for row in page.state.events] == pytest.approx(
        [event.tick / 1000 for event in events], abs=2e-3
    )
    assert page.state.charts[0]["lines"][0]
    assert page.state.numbers[0]["value"] == page.state["values"][0][0]


def test_beside_a_replica():
    with burrlab.Session(
        burrlab.StartingBone(make_bone(BLOCK), source=BLOCK),
        tool(),
        straight(*PATH),
        seed=1,
        duration=1.5,
        publish=0,
    ) as session:
        replica = follow("127.0.0.1", session.port)
        try:
            page = make_page(page_source(replica))
            assert (page.state.title, page.state.source_state) == ("replica", "following")
            assert soon(lambda: turn(page) and replica.wait(0.0), 30.0)
            turn(page)
            assert page.source.bone.digest() == replica.digest() == session.snapshot()[0].digest()
            assert page.source.bone.removed > 0
            assert page.state.source_state not in ("following", "")
        finally:
            replica.stop()


def test_parcels_of_a_companion():
    session = nerve_session()
    with Companion(session, seed=1) as companion, session:  # bone gone before makes no dust
        session.wait()
        assert companion.wait(30)
        page = make_page(page_source(session, companion))
        assert page.state.has_effects
        page._turn(0.0)
        assert len(page.scene.set_parcels.call_args.args[0]) == len(companion.parcels) > 0
        page.state.tell("effects", False)
        page.scene.set_parcels.assert_called_with(None)


def test_parcels_of_a_trace(trace):
    past = ParcelHistory(trace, Effects(trace.bone(), seed=1))
    assert (past.at(2.0), past.make(), past.made, past.at(0.0)) == (None, True, 1.0, None)
    other, some = Effects(trace.bone(), seed=1), 0
    for time in effects_of(burrlab.view.TracePlayer(trace), other):
        frame, parcels = past.at(time), other.parcels
        assert len(frame) == len(parcels)
        some = max(some, len(parcels))
        np.testing.assert_allclose(frame["position"], parcels["position"], atol=0.02, rtol=0)
        np.testing.assert_allclose(frame["radius"], parcels["radius"], rtol=1e-3)
        share = 255 * parcels["dust"] / np.maximum(parcels["dust"] + parcels["blood"] + parcels["water"], 1)
        np.testing.assert_allclose(frame["dust"], share, atol=0.51, rtol=0)
    assert some > 50
    whole = sum(frame.nbytes for frame in past._frames)
    small = ParcelHistory(trace, Effects(trace.bone(), seed=1), memory=whole / 3e6)
    assert small.make()
    assert sum(frame.nbytes for frame in small._frames) <= whole / 3
    late = small.at(trace.duration)
    assert any(
        len(past.at(t)) == len(late) and (past.at(t) == late).all() for t in np.arange(2.0, 4.01, 0.05)
    )


def test_parcels_stop_when_asked(trace):
    past, cancel = ParcelHistory(trace, Effects(trace.bone(), seed=1)), threading.Event()
    cancel.set()
    assert not past.make(cancel)
    assert past.made < 0.1


def test_refused_sources(trace):
    refused(
        (
            lambda: web.serve("a"),
            "source must be a Trace, TracePlayer, RecordingPlayer, Session, .*, got 'a'",
        ),
        (lambda: web.serve(trace, effects=1), "effects of a trace must be Effects, got 1"),
        (lambda: web.serve(nerve_session(), effects=1), "effects of a session must be a Companion, got 1"),
        (
            lambda: web.serve(nerve_bone(), effects=1),
            "effects go with a trace or a session, got 1 with a bone",
        ),
        error=TypeError,
    )


def test_refused_ports(capsys, tmp_path):
    """The command line refuses a taken port before anything else is done."""
    pytest.importorskip("trame", reason="needs the extra viz3d")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        listen, bone = f"cannot listen on 127.0.0.1:{port}: Address already in use", nerve_bone()
        refused(
            (lambda: web.serve(bone, port=-1), "port must be from 0 to 65535, got -1"),
            (lambda: web.serve(bone, port=65536), "port must be from 0 to 65535, got 65536"),
            (lambda: web.serve(bone, port=port), listen, OSError),
            (lambda: web.serve(bone, host="192.0.2.1"), r"cannot listen on 192\.0\.2\.1:0: ", OSError),  # of documentation
        )  # fmt: skip
        words = ["--device", "hand", "--duration", 1, "--record", tmp_path / "none.h5"]
        assert listen in refusal(capsys, "session", *words, "--web", port)
    assert not (tmp_path / "none.h5").exists()


def test_refused_in_an_event_loop():
    async def inside():
        web.serve(nerve_bone())

    refused(
        (lambda: asyncio.run(inside()),
         "serve blocks until the page ends, and an event loop runs here", RuntimeError),
    )  # fmt: skip


async def talk(host, path, origin, secret, calls):
    """(status of the page, of its WebSocket, answers to hello and calls, page) from a page that listens."""
    import aiohttp
    import msgpack
    from wslink.chunking import UnChunker, generate_chunks

    server, source = web._server(), page_source(nerve_bone())
    page = Page(server, source, make_scene())
    server.controller.on_server_bind.add(
        lambda one: web._prepare(one, server.protocol, "127.0.0.1", "s3cret")
    )
    ready, silent = server.ready, {"open_browser": False, "show_connection_info": False, "timeout": 0}
    server.start(host="127.0.0.1", port=0, exec_mode="task", thread=True, **silent)
    await ready
    headers = {"Host": host.format(server.port), **({"Origin": origin.format(server.port)} if origin else {})}
    address, answers = f"http://127.0.0.1:{server.port}{path}", []
    async with aiohttp.ClientSession(headers=headers) as client:
        status = (await client.get(address)).status
        try:
            socket = await client.ws_connect(f"{address}ws", max_msg_size=0)
        except aiohttp.WSServerHandshakeError as error:
            return status, error.status, answers, page
        for number, (method, *arguments) in enumerate([("wslink.hello", {"secret": secret}), *calls]):
            name, reader, told = f"{'rpc' if number else 'system'}:{number}", UnChunker(), None
            asked = {"wslink": "1.0", "id": name, "method": method, "args": arguments}
            for chunk in generate_chunks(msgpack.packb(asked), 4_000_000):
                await socket.send_bytes(chunk)
            reader.set_max_message_size(2**30)
            while told is None or told.get("id") != name:
                told = reader.process_chunk((await asyncio.wait_for(socket.receive(), 20)).data)
            answers.append(told.get("result", told.get("error")))
        await socket.close()
    await server.stop()
    return status, 101, answers, page


def talked(host="127.0.0.1:{}", path="/s3cret/", origin="", secret="s3cret", calls=(("trame.state.get",),)):
    pytest.importorskip("trame", reason="needs the extra viz3d")
    return asyncio.run(talk(host, path, origin, secret, calls))


def test_the_page_is_at_its_address_and_with_its_secret():
    for host in ("127.0.0.1:{}", "localhost:{}", "[::1]:{}"):
        status, upgraded, (hello, state), _ = talked(host, origin=f"http://{host}")
        assert (status, upgraded, "clientID" in hello, state["state"]["title"]) == (200, 101, True, "bone")
    for other in ("wslink-secret", "", None):
        assert [answer["code"] for answer in talked(secret=other)[2]] == [-32000] * 2


@pytest.mark.parametrize(
    "other",
    [
        {"host": "evil.example:{}", "origin": "http://evil.example:{}"}, {"host": "127.0.0.1:1"}, {"origin": "null"},
        {"origin": "http://evil.example:{}"}, {"origin": "https://127.0.0.1:{}"}, {"path": "/"}, {"path": "/wslink-secret/"},
    ],
)  # fmt: skip
def test_whoever_asks_in_another_way_gets_nothing(other):
    assert talked(**other)[:2] == (403, 403)


def test_the_socket_without_an_upgrade(caplog):
    """A refusal, not an error of the server, whose log stays empty."""
    assert talked(path="/s3cret/ws", calls=())[0] == 400
    assert not [record for record in caplog.records if record.exc_info]


def test_what_a_browser_can_call_and_change():
    nan = float("nan")
    gone = [
        ("application.exit",),
        ("application.exit.later", 0),
        ("trame.force.push", "title"),
        ("file.list", "/"),
    ]
    values = [("title", "mine"), ("trame__template_main", "<img onerror=alert(1)>"), ("new", 1), ("slices", "/etc"), ("speed", -5),
              ("speed", True), ("wanted_s", nan), ("wanted_s", {})]  # fmt: skip
    triggers = [
        ("drag", nan, 0.0, False),
        ("drag", "x", 1, 2),
        ("wheel", 1e999),
        ("shown", 1e5, "a"),
        ("none",),
    ]
    idle = [
        *(("trame.state.update", [{"key": key, "value": value}]) for key, value in values),
        ("trame.state.update", 5),
        ("trame.state.update", [{"no": 1}]),
        ("trame.trigger",),
        ("trame.trigger", [], [], {}),
        *(("trame.trigger", name, list(arguments), {}) for name, *arguments in triggers),
        ("trame.lifecycle.update", "server_bind"),
        ("trame.error.client", "a line\nof its own"),
    ]
    done = [
        ("trame.state.update", [{"key": "slices", "value": True}, {"key": "speed", "value": 2}]),
        ("trame.trigger", "drag", [0.5, 0.25, False], {}),
    ]
    look = [("trame.state.get",)]
    _, _, (_, first, *answers, last), page = talked(calls=[*look, *gone, *idle, *done, *look])
    assert [answer["code"] for answer in answers[: len(gone)]] == [-32601] * len(gone)
    assert answers[len(gone) :] == [None] * (len(idle) + len(done))
    assert last["state"] == {**first["state"], "slices": True, "speed": 2}
    calls = [
        call for call in page.scene.plotter.camera.method_calls if call != mock.call.OrthogonalizeViewUp()
    ]
    assert calls == [mock.call.Azimuth(-100.0), mock.call.Elevation(-50.0)]


@pytest.mark.parametrize(("name", "what"), [("pyvista", "the view"), ("trame", "the page")])
def test_a_missing_extra(monkeypatch, name, what):
    pytest.importorskip("trame", reason="needs the extra viz3d")
    for module in list(sys.modules):
        if module.split(".")[0] == name:
            monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, name, None)
    refused(
        (lambda: web.serve(nerve_bone()),
         rf"{what} needs {name}: pip install 'burrlab\[viz3d\]'", ImportError),
    )  # fmt: skip
