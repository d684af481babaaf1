"""The page's state without a browser: wishes are done, and its texts are true."""

import asyncio
import base64
import io
from unittest import mock

import numpy as np
import pytest
from anatomy_scenes import nerve_bone, tool
from page_scenes import make_page, nerve_session, turn, watched_trace  # noqa: F401
from PIL import Image
from session_scenes import FakeReader, ended, new_writer

import burrlab
import burrlab.view.page as page_chart
from burrlab.effects.effects import Effects
from burrlab.session.player import TracePlayer
from burrlab.view.page_source import page_source
from burrlab.view.surface import brick_numbers


@pytest.fixture
def page(trace):
    return make_page(page_source(trace))


def rows(page):
    return {row["name"]: row["value"] for row in page.state.numbers}


@pytest.mark.parametrize("moment", [0.0, 1.234, 3.9995])
def test_says_what_the_player_has(page, trace, moment):
    turn(page, 1.0, wanted=moment)
    player = TracePlayer(trace)
    player.seek(moment)
    bone, said, values = player.bone, rows(page), page.state["values"]
    assert (page.source.bone.digest(), page.state.time_s) == (bone.digest(), pytest.approx(player.time))
    assert (said["bone removed"], said["centre"]) == (
        f"{bone.removed:.2f}", ", ".join(f"{value:.2f}" for value in player.burrs.centers[0]),
    )  # fmt: skip
    assert said["force"] == values[0][0] == f"{np.linalg.norm(player.force):.2f}"
    assert said["penetration"] == values[1][0] == f"{player.depth[0]:.3f}"
    assert (page.scene.move_burrs.call_args.args[0] == player.burrs.centers).all()
    (nerve,) = [row for row in page.state.tissues if row["name"] == "nerve"]
    lost = bone.removed_of("nerve")
    assert (nerve["removed"], nerve["hurt"]) == (f"{lost:.2f}", lost > 0)


def test_only_the_newest_wish_is_done(page):
    before = page.scene.update.call_count
    for moment in np.linspace(0.1, 2.9, 29):
        page.state.tell("wanted_s", moment)
    turn(page, 1.0, wanted=3.0)
    assert (page.scene.update.call_count, page.state.time_s) == (before + 1, pytest.approx(3.0))


def test_waits_for_the_browser_then_no_longer(page):
    number = turn(page, 10.0, shown=False, wanted=1.0)
    assert (turn(page, 11.9, shown=False, wanted=2.0), turn(page, 12.1, shown=False)) == (number, number + 1)
    page.shown()
    assert turn(page, 12.2, wanted=1.5) == number + 2


def test_a_picture_at_rest_is_smooth_once(page):
    renderer = page.scene.plotter.renderer
    assert renderer.method_calls == [mock.call.SetUseFXAA(True)]
    page.draw()
    for now, smooth in ((1.0, False), (1.2, False), (1.4, True)):
        number = turn(page, now)
        assert renderer.method_calls[-1] == mock.call.SetUseFXAA(smooth)
    assert turn(page, 9.0) == number
    kind, data = page.state.picture.split(",")
    assert kind == "data:image/jpeg;base64"
    assert Image.open(io.BytesIO(base64.b64decode(data))).size == (8, 8)


def test_plays_at_its_speed_to_the_end_and_again(page, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("burrlab.view.page.time.monotonic", lambda: now[0])
    page.state.tell("speed", 2.0)
    page.state.tell("playing", True)
    for _ in range(5):
        now[0] += 0.1
        turn(page, now[0])
    assert (page.state.time_s, page.state.wanted_s) == (pytest.approx(1.0, abs=2e-3), pytest.approx(1.0))
    now[0] += 5.0
    turn(page, now[0])
    assert (page.state.time_s, page.state.playing) == (page.source.span[1], False)
    page.state.tell("playing", True)
    now[0] += 0.1
    turn(page, now[0])
    assert page.state.time_s == pytest.approx(0.2, abs=2e-3)


def test_steps_and_seeks_stay_in_the_trace(page):
    for wish, moment in (
        (lambda: page.seek(0.5), 2.0), (lambda: page.step(1), 2.001), (lambda: page.step(-2), 1.999),
        (lambda: page.seek(7), 4.0), (lambda: page.step(1), 4.0), (lambda: page.go(-1), 0.0), (lambda: page.step(-1), 0.0),
    ):  # fmt: skip
        wish()
        turn(page, 1.0)
        assert (page.state.wanted_s, page.state.time_s) == pytest.approx((moment, moment))


def test_the_mouse_moves_the_camera(page):
    camera = page.scene.plotter.camera
    number = page.state.picture_number
    page.drag(0.1, -0.1, False)
    page.wheel(2)
    turned = [mock.call.Azimuth(-20.0), mock.call.Elevation(20.0), mock.call.OrthogonalizeViewUp()]
    assert camera.method_calls == [*turned, mock.call.Dolly(pytest.approx(1.15**2))]
    assert turn(page, 1.0) == number + 1
    page.drag(1.0, 0.0, True)  # by the picture's height
    height = 2 * 50.0 * np.tan(np.deg2rad(15.0))
    assert camera.focal_point == pytest.approx((-height, 0, 0))
    assert camera.position == pytest.approx((-height, 0, 50))
    assert turn(page, 1.1) == number + 2


def test_a_window_of_another_size(page):
    number = page.state.picture_number
    for said, size in (((800, 500), (800, 500)), ((99999, 3), (2560, 64))):
        page.shown(*said)
        assert page.scene.plotter.window_size == size
    assert turn(page, 1.0) == number + 1


def test_views_and_slices(page):
    scene, (first,) = page.scene, page.scene.look.call_args.args
    turn(page, 1.0, wanted=2.0)
    center = page.source.burrs.centers[0]
    page.look("burr")
    assert scene.look.call_args.args[0].focus == pytest.approx(tuple(center))
    page.look("-z")
    assert (
        np.subtract(*(getattr(scene.look.call_args.args[0], name) for name in ("focus", "position")))[2] < 0
    )
    page.look("surgeon")
    scene.look.assert_called_with(first)
    page.state.tell("slices", True)
    assert scene.set_slices.call_args.args[0] == pytest.approx(center)
    page.state.tell("slices", False)
    scene.set_slices.assert_called_with(None)
    for stereo in (True, False):
        number = turn(page, 2.0)
        page.state.tell("stereo", stereo)
        scene.set_stereo.assert_called_with(stereo)
        assert turn(page, 2.0) == number + 1


def test_a_burr_far_away_is_looked_at(tmp_path):
    """The burr is far away, as when a hand lifts it."""
    ended(nerve_session(([(0, 0, 1.5), (0, 0, 200.0)], [0, 0.5]), record=tmp_path / "trace.h5"))
    page = make_page(page_source(burrlab.load_trace(tmp_path / "trace.h5")))
    turn(page, 1.0, wanted=0.5)
    page.look("burr")
    assert page.scene.look.call_args.args[0].focus == pytest.approx((0, 0, 200), abs=0.5)


def test_a_trace_without_a_tick_has_all_its_parcels(tmp_path):
    record = tmp_path / "trace.h5"
    new_writer(record, FakeReader(), nerve_bone(), [tool()], seed=1).stop()
    trace = burrlab.load_trace(record)
    page = make_page(page_source(trace, Effects(trace.bone(), seed=1)))
    turn(page, 1.0)
    assert (page.source.prepared, page.source.parcels) == (1.0, None)


def test_an_error_is_said_and_the_page_goes_on(page):
    async def until(reached):
        while not reached():
            await asyncio.sleep(0.01)

    async def some_turns():
        work = asyncio.create_task(page.run())
        with mock.patch.object(page.source, "go", side_effect=OSError("the disk is gone")):
            page.state.tell("wanted_s", 1.0)
            page.state.playing = True
            await asyncio.wait_for(until(lambda: page.state.problem), 20)
        assert (page.state.problem, page.state.playing) == ("OSError: the disk is gone", False)
        await asyncio.wait_for(until(lambda: page.state.time_s >= 1.0), 20)
        work.cancel()

    asyncio.run(some_turns())


def test_what_could_not_be_drawn_is_drawn_by_the_next_turn(page):
    """A scene that fails twice still draws everything afterwards."""
    before = page.source.bone.density
    page.scene.update.side_effect = [MemoryError, MemoryError, 1]
    for moment in (2.0, 3.0):
        with pytest.raises(MemoryError):
            turn(page, moment, wanted=moment)
    turn(page, 4.0)
    assert page.state.time_s == pytest.approx(3.0)
    changed = np.argwhere(page.source.bone.density != before) // 8
    assert set(brick_numbers(changed, page.source.bone)) <= set(page.scene.update.call_args.args[1])
    turn(page, 5.0, wanted=3.0005)
    assert page.scene.update.call_count == 3  # drawn only once


def test_events_of_the_trace(page, trace):
    assert [row["text"] for row in page.state.events[:4]] == [
        "approach to nerve, 0.50 mm", "touch of nerve", "injury of nerve", "away from nerve, 1.00 mm",
    ]  # fmt: skip
    for row, event in zip(page.state.events, trace.events, strict=True):
        assert row["time_s"] == pytest.approx(trace.time()[event["tick"]])
        assert row["x"] == pytest.approx(1000 * row["time_s"] / 4.0, abs=0.1)


def test_distances_once_their_fields_are_made(page, trace):
    assert page.state.distances == []
    page.source.open()
    page.source._background[-1].join()
    page.go(trace.time()[trace.events[0]["tick"]])  # an approach
    turn(page, 2.0)
    nerve = next(row for row in page.state.distances if row["name"] == "nerve")
    assert float(nerve["value"]) == pytest.approx(0.5, abs=0.01)
    assert nerve["near"]
    page.source.close()
    assert page.source.prepared == 1.0


def test_curves_keep_their_peaks():
    def points(time, values, span, most):
        return [pair.split(",") for pair in page_chart.polyline(time, values, span, most).split()]

    time = np.arange(1, 60001) / 1000
    values = np.sin(time) ** 2
    values[33333] = 7.0
    drawn = np.array(points(time, values, (0, 60), 10.0), float)
    assert len(drawn) == 1000
    assert (np.diff(drawn[:, 0]) >= 0).all()
    assert drawn[drawn[:, 1].argmin()] == pytest.approx((1000 * 33.334 / 60, 30.0), abs=2)
    assert [x for x, _ in points(time[:3], values[:3], (0, 0.004), 1.0)] == ["250.0", "500.0", "750.0"]
    assert points(time[:0], values[:0], (0, 1), 1.0) == []


@pytest.mark.parametrize(
    ("largest", "end"), [(0, 1), (0.9, 1), (1, 1), (1.1, 2), (4.2, 5), (7, 10), (0.03, 0.05)]
)
def test_axis_ends(largest, end):
    assert page_chart.top(np.array([0.0, largest])) == pytest.approx(end)


def test_a_bone_that_rests():
    page = make_page(page_source(nerve_bone()))
    turn(page, 1.0)
    assert (page.state.source_state, rows(page)) == ("600 mm³ of bone", {"bone removed": "0.00"})
    assert page.state.charts == page.state.events == []
    page.look("burr")  # there is no burr
    page.state.tell("slices", True)
    assert page.scene.set_slices.call_args.args[0] == pytest.approx((0, 0, -3))
