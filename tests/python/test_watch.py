"""A watch: its refusals; in a session its events at their ticks, doses, the trace, replay and gaps."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from anatomy_scenes import NAMES, nerve_bone, straight, tool
from effects_scenes import bone_with_tissues
from session_scenes import ended, refused, session_of

from burrlab import (
    VoxelBone,
    _core,
    load_bone,
    load_trace,
    replay,
    save_bone,
    session_metrics,
)
from burrlab.anatomy import AnatomyReport, Watch, anatomy_report
from burrlab.anatomy.events import KINDS
from burrlab.session.replay import inputs
from reference import anatomy as reference

LIMITS = {"approach": 2.0, "touch": 0.1, "injury": 0.05, "hysteresis": 0.4}
# Down beside the nerve and into it, up again, and once more: [mm] at [s].
DOWN = [(0, 0, 4.0), (0, 0, -0.6), (0, 1, 4.0), (0, 1, 0.2), (0, 0, 4.5)]
TIMES = [0.0, 0.6, 1.0, 1.3, 1.6]


def run(path=None, *, bone=None, watch=LIMITS, devices=None, tools=None, **options):
    """A session that has not begun; a watch given as limits is made here."""
    bone = nerve_bone() if bone is None else bone
    return session_of(
        bone, tool() if tools is None else tools, straight(DOWN, TIMES) if devices is None else devices, seed=3,
        record=path, watch=Watch(bone, **watch) if isinstance(watch, dict) else watch,
        **{"duration": 1.6, "wall_clock": False, **options},
    )  # fmt: skip


def ran(*given, **options):
    """A session at its end."""
    return ended(run(*given, **options))


def lost_of(trace, tissue):
    """Volume lost by a tissue in each tick [mm^3], from a replay tick by tick."""
    bone = trace.bone()
    executor = _core.TickExecutor(bone, list(trace.tools), trace.seed, tick=trace.first_tick)
    masses = [bone.mass_of(tissue)]
    for i in range(len(trace)):
        executor.execute(inputs(trace.ticks[i : i + 1]))
        masses.append(bone.mass_of(tissue))
    return -np.diff(masses)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("watch") / "near.h5"
    said = []
    return ran(path, on_message=said.append), load_trace(path), said


def test_events_and_doses_are_those_of_the_definition(recorded) -> None:
    session, trace, _ = recorded
    watch, report = Watch(trace.bone(), **LIMITS), session.anatomy()
    force = np.linalg.norm(trace.array("force_N"), axis=1)
    k, on = trace.ticks["k"].astype(float), trace.array("on") == 1
    for number, name in enumerate(watch.structures):
        distances = watch.distance(trace.array("center_mm"), name, radius=1.0)
        lost = lost_of(trace, name)
        told = reference.events(np.zeros(len(trace), int), distances, lost, **LIMITS)
        rows = trace.events[trace.events["structure"] == number]
        assert [(int(e["tick"]), KINDS[e["kind"]], int(e["burr"])) for e in rows] == told
        np.testing.assert_array_equal(rows["distance_mm"], distances[rows["tick"].astype(int)])
        want, dose = reference.dose(distances, k, on, force, touch=LIMITS["touch"]), report.dose(name)
        assert dose.closest == want["closest"] == distances[dose.closest_tick]
        assert dose.closest_center == tuple(trace.array("center_mm")[dose.closest_tick])
        assert dose.touching == pytest.approx(want["touching"] / 1000)
        for field in ("time_within", "turning_within"):
            assert list(getattr(dose, field).values()) == pytest.approx(np.array(want[field]) / 1000)
        assert list(dose.mean_force.values()) == pytest.approx(want["mean_force"], nan_ok=True)
        assert list(dose.peak_force.values()) == pytest.approx(want["peak_force"])
        assert dose.removed == pytest.approx(lost.sum(), abs=1e-9)
    kinds = [KINDS[e["kind"]] for e in trace.events if e["structure"] == 0]
    assert kinds == ["approach", "touch", "injury", "away", "approach", "away"]
    assert (np.diff(trace.events["tick"].astype(int)) >= 0).all()
    assert report.dose("nerve").removed > 0.05
    assert report.closest["nerve"] == report.dose("nerve").closest < 0


def test_session_trace_and_replay_say_the_same_to_the_bit(recorded) -> None:
    session, trace, _ = recorded
    kept, again = AnatomyReport.recorded(trace), anatomy_report(trace)
    assert again.equals(kept)
    assert session.anatomy().equals(kept)
    assert not anatomy_report(trace, watch=Watch(trace.bone(), **{**LIMITS, "approach": 3.0})).equals(kept)
    after, _ = session.snapshot()
    for name in NAMES:
        assert again.removed[name] == pytest.approx(
            trace.bone().mass_of(name) - after.mass_of(name), abs=1e-9
        )
    assert again.removed["bone"] > 0 < again.removed["nerve"]


def test_what_happens_is_said_while_the_session_runs(recorded) -> None:
    session, trace, said = recorded
    events = [event for event in session.anatomy().events if event.kind != "away"]
    assert [str(event) for event in events] == [text for text in said if text.startswith("burr 0: ")]
    assert str(events[0]) == f"burr 0: 2 mm from nerve at tick {events[0].tick}"
    for words in ("burr 0: touches nerve at tick ", "burr 0: injures nerve, "):
        assert any(text.startswith(words) for text in said)
    assert trace.watch == Watch(trace.bone(), **LIMITS).settings


def test_the_report_tells_what_is_more_than_a_graze(recorded) -> None:
    deep, limited = ran(watch={}).anatomy(), recorded[0].anatomy()
    time, volume = deep.dose("nerve").touching, deep.removed["nerve"]
    assert min(time, volume) >= 0.1
    assert (deep.touched, deep.injured) == ({"nerve": time}, {"nerve": volume})
    said = f"touched for 0.1 s or more [s]: nerve {time:.3g}\ninjured by 0.1 mm^3 or more [mm^3]: nerve {volume:.3g}"
    assert said in str(deep)
    told = deep.to_dict()
    assert (told["touched_s"], told["injured_from_mm3"]["nerve"]) == ({"nerve": time}, 0.1)
    assert "injury" in {event["kind"] for event in told["events"]}  # events stay exact
    small = replace(deep, watched=replace(deep.watched, removed=deep.watched.removed // 1000))
    assert (small.injured, "injured by 0.1 mm^3 or more [mm^3]: nothing" in str(small)) == ({}, True)
    assert limited.injured == {"nerve": limited.removed["nerve"]}  # by the watch's own limit, 0.05 mm^3
    assert "injured by 0.05 mm^3 or more" in str(limited)


def test_two_burrs_are_told_apart(tmp_path) -> None:
    still = straight([(-3, 0, 1.2), (-3, 0, 1.2)], [0.0, 1.6])
    path = tmp_path / "two.h5"
    session = ran(path, devices=[still, straight(DOWN, TIMES)], tools=[tool(1.5), tool(1.0)])
    trace, report = load_trace(path), session.anatomy()
    assert {event.burr for event in report.events if event.kind in ("touch", "injury")} == {1}
    assert report.dose("nerve", 0).removed == 0 < report.dose("nerve", 1).removed
    watch = Watch(trace.bone(), **LIMITS)
    for burr, radius in enumerate((1.5, 1.0)):
        distances = watch.distance(trace.array("center_mm", burr), "nerve", radius=radius)
        assert report.dose("nerve", burr).closest == distances.min()
    assert anatomy_report(trace).equals(report)


def test_a_killed_session_keeps_its_events(tmp_path) -> None:
    path, early = tmp_path / "killed.h5", tmp_path / "early.h5"
    mailbox = _core.MailboxDevice(lost_after=1e4)
    with run(path, devices=mailbox, watch={}, wall_clock=True, realtime=False, duration=60) as session:
        mailbox.put((0, 0, 1.5))
        for _ in range(100):
            session.wait(0.05)
            if len(load_trace(path).events) == 1:
                break
        early.write_bytes(path.read_bytes())  # the file as a kill would leave it
    trace = load_trace(early)
    assert (trace.watched, AnatomyReport.recorded(trace), len(trace.events)) == (None, None, 1)
    assert trace.events["tick"][0] < trace.first_tick + len(trace)
    assert anatomy_report(trace).watched.events.tobytes() == trace.events.tobytes()
    assert load_trace(path).watched is not None


def test_ticks_that_are_passed_over_are_said_and_injuries_stay_whole(recorded) -> None:
    session = run()
    session.follower.ask_rebuild()
    with session:
        for _ in range(40):
            session.follower.ask_rebuild()
            session.wait(0.02)
        session.wait()
    report = session.anatomy()
    assert report.removed == recorded[0].anatomy().removed
    if report.watched.ticks_passed_over:  # the follower may have been ahead each time
        assert report.watched.gaps > 0
        assert "ticks were passed over" in str(report)


def test_tissues_without_a_watch_are_counted(tmp_path) -> None:
    report, trace = (
        ran(tmp_path / "plain.h5", watch=None).anatomy(),
        load_trace(tmp_path / "plain.h5"),
    )
    assert report.structures == ()
    assert report.removed["nerve"] > 0.05
    assert (trace.watched, trace.watch, len(trace.events)) == (None, {}, 0)
    assert anatomy_report(trace).structures == ("nerve", "sinus")  # all that are critical
    assert anatomy_report(trace).removed == report.removed


def test_a_bone_without_tissues_has_no_watch(tmp_path) -> None:
    path = tmp_path / "old.h5"
    bone = VoxelBone.block((8, 8, 4), 0.2, origin=(-4, -4, -4))
    down = straight([(0, 0, 2), (0, 0, 0.8)], [0, 0.1])
    session = ran(path, bone=bone, watch=None, devices=down, duration=0.1)
    with h5py.File(path) as file:
        assert "watch" not in file
        assert "watch" not in json.loads(file["note"][()])
    assert session.report().anatomy is None
    for told in (session.report(), session_metrics(load_trace(path))):
        assert "anatomy" not in told.to_dict()
    refused(
        (session.anatomy, "bone of the session must have tissues"),
        (lambda: anatomy_report(load_trace(path)), "trace must be of a bone with tissues"),
        (lambda: anatomy_report(path), "trace must be a Trace", TypeError),
    )


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        *((lambda _, options=options: Watch(nerve_bone(), **options), sentence) for options, sentence in [
            ({"structures": ["vein"]}, "tissue must be one of bone, nerve, sinus, unused, got 'vein'"),
            ({"structures": ["unused"]}, "structure must have voxels, 'unused' has none"),
            ({"structures": ["nerve", "nerve"]}, "structures must differ, got nerve, nerve"),
            ({"structures": []}, "structures must be at least one, got none"),
            ({"approach": 1.0, "touch": 1.5}, "approach of 'nerve' must be finite and at least touch, got 1"),
            ({"approach": float("nan")}, "approach of 'nerve' must be finite"),
            ({"approach": 15.0}, "approach of 'nerve' with hysteresis and radius must be at most 15 mm"),
            ({"touch": -0.1}, "touch of 'nerve' must be zero or positive"),
            ({"injury": -1.0}, "injury of 'nerve' must be zero or positive"),
            ({"hysteresis": 0.0}, "hysteresis of 'nerve' must be positive"),
            ({"approach": {"bone": 1.0}}, "approach must be of watched structures, got one of 'bone'"),
        ]),
        (lambda _: Watch.of_settings(nerve_bone(), {"hysteresis_mm": 1.0, "structures": 2 * Watch(nerve_bone()).settings["structures"][:1]}),
         "structures must differ, got nerve, nerve"),
        (lambda _: Watch(VoxelBone.block((2, 2, 2), 0.2)),
         "bone must have tissues, got one of a single material"),
        (lambda _: Watch(bone_with_tissues()), "structures must be named: no tissue of the bone is critical"),
        (lambda _: run(watch=Watch(nerve_bone())),
         "bone must be the one that the watch was made of, or a copy of it"),
        (lambda _: Watch(nerve_bone(), structures="nerve").distance((0, 0, 0), "sinus"),
         "structure must be one of nerve, got 'sinus'"),
        (lambda _: Watch(nerve_bone()).core([7.0]),
         "radius of a burr that is watched must be at most 6 mm, got 7"),
        (lambda report: report.dose("bone"), "structure must be one of nerve, sinus, got 'bone'"),
        (lambda report: report.dose("nerve", 1), "burr must be an index below 1, got 1"),
    ],
)  # fmt: skip
def test_what_is_refused(recorded, call, sentence) -> None:
    refused((lambda: call(recorded[0].anatomy()), sentence))


def test_limits_and_structures_by_name() -> None:
    watch = Watch(nerve_bone(), approach={"nerve": 1.0}, structures="nerve")
    assert (watch.limits[0].approach, watch.structures) == (1.0, ("nerve",))


def test_a_session_goes_on_from_a_file_with_its_tissues(tmp_path) -> None:
    """Session, trace and replay begin with a saved, partly removed bone with tissues."""

    def lowered(bone, first, last, **options):
        device = straight([(0, 0, first), (0, 0, last)], [0, 0.3])
        return ran(bone=bone, devices=device, duration=0.3, **options)

    save_bone(tmp_path / "bone.h5", *lowered(nerve_bone(), 1.5, -0.3, watch=None).snapshot())
    bone, tick = load_bone(tmp_path / "bone.h5")
    gone = bone.removed_of("nerve")
    assert gone > 0
    second = lowered(bone, -0.2, -0.8, tick=tick, path=tmp_path / "on.h5")
    after, _ = second.snapshot()
    report, trace = second.anatomy(), load_trace(tmp_path / "on.h5")
    assert trace.first_tick == tick > 0
    assert report.removed["nerve"] == pytest.approx(after.removed_of("nerve") - gone, abs=1e-9)
    assert anatomy_report(trace).equals(report)
    assert replay(trace).equal
