"""Dust, blood, water and a sucker, frame by frame; with extreme numbers they end, finite, and the accounts hold."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from effects_scenes import SOLID, TOOL, bone_with_tissues, buried_parcels, levels_removed, session
from session_scenes import ended, refused

from burrlab import Burr, BurrContact, Clock, ScriptedDevice, Session, VoxelBone, _core, load_trace
from burrlab.effects import Camera, Companion, EffectParameters, Effects, Nozzle, Sucker, effects_of
from burrlab.session.player import TracePlayer

TILE = np.zeros((1, 8, 8, 8), np.uint8)
WATER = Nozzle((2, 0, 3), (-0.5, 0, -0.9), rate=100)


def carved(frames: int, to_repeat=None, decisions=None, **options) -> tuple[Effects, VoxelBone]:
    """(effects, bone) after frames of 50 ms, each with five ticks of 10 ms of a burr that goes along x."""
    bone = bone_with_tissues()
    effects = Effects(bone, **{"seed": 1, "nozzle": WATER, **options})
    contact = BurrContact(bone, Burr(2.0), SOLID, seed=3)
    _core.take_changed_bricks(bone)
    for frame in range(frames):
        center = (-2 + 0.1 * frame, 0.0, 1.7)
        for _ in range(5):
            contact.step(center, 10.0)
        bricks = _core.take_changed_bricks(bone)
        update = {"bricks": bricks, "density": _core.read_bricks(bone, bricks)}
        decision = effects.step(
            0.05, update, [(center, 2.0)], decision=to_repeat[frame] if to_repeat else None
        )
        if decisions is not None:
            decisions.append(decision)
        accounts = effects.balance()
        assert all(account.exact for account in accounts.values())
        assert accounts["dust"].made == levels_removed(bone) == sum(effects.removed)
        assert not buried_parcels(effects, bone)
    return effects, bone


def test_balance_of_a_cut() -> None:
    effects, bone = carved(40, sucker=Sucker((1, 1, 0.5), rate=50))
    accounts = effects.balance()
    assert min(accounts["blood"].made, accounts["water"].sucked) > 0
    assert effects.removed[1] * effects.quantum == pytest.approx(bone.removed_of("sinus"), rel=1e-12)
    water = accounts["water"].volumes()
    assert water["made"] == pytest.approx(200, abs=2 * effects.quantum)
    assert water["made"] == pytest.approx(water["present"] + water["sucked"] + water["drained"])


def test_parcels_are_what_the_balance_says() -> None:
    effects, _ = carved(20)
    parcels = effects.parcels
    for name, account in effects.balance().items():
        assert parcels[name].sum() == account.present
    volume = effects.quantum * (
        EffectParameters().dust_bulking * parcels["dust"] + parcels["blood"] + parcels["water"]
    )
    np.testing.assert_allclose(4 / 3 * np.pi * parcels["radius"] ** 3, volume, rtol=1e-12)
    assert parcels.dtype.names == ("position", "velocity", "radius", "dust", "blood", "water", "age")
    assert ((parcels["dust"] > 0) & (parcels["water"] > 0)).any(), "no paste"
    kept = parcels.copy()
    effects.step(0.05)
    assert (parcels == kept).all(), "a copy"


def test_same_frames_give_same_parcels() -> None:
    one, same, other = (carved(15, seed=seed)[0].parcels for seed in (1, 1, 2))
    assert (one == same).all()
    assert len(one) != len(other) or not (one == other).all()


def test_decisions_of_the_clock_can_be_given_again() -> None:
    hurried, _ = carved(30, decisions=(decisions := []), budget=1e-5)
    report = hurried.report()
    assert min(report.crowded, report.over_budget, report.sub_steps_least == 1) > 0
    again, _ = carved(30, decisions)
    assert (hurried.parcels == again.parcels).all()


def test_update_by_place_and_by_number() -> None:
    for bricks in (np.array([[1, 2, 3]]), [1 * 64 + 2 * 8 + 3]):
        effects = Effects(bone_with_tissues(), seed=1)
        effects.step(0.05, {"bricks": bricks, "density": np.zeros((1, 8, 8, 8), np.uint8)})
        assert effects.balance()["dust"].made == 512 * 255


def test_a_nozzle_waits_for_its_burr() -> None:
    effects = Effects(bone_with_tissues(), seed=1, nozzle=WATER)
    effects.step(0.05)
    assert effects.balance()["water"].made == 0
    effects.nozzle = Nozzle((0, 0, 9), burr=None)
    effects.step(0.05)
    assert effects.balance()["water"].made > 0


def test_the_budget_decides_how_fine() -> None:
    """With little time there are fewer sub-steps, then fewer parcels; the account stays exact."""
    parameters = EffectParameters(most_parcels=50_000, water_parcel=0.01, liquid_friction=1.0)
    nozzle = Nozzle((0, 0, 9), (0, 0, -1), rate=200, burr=None, speed=300)
    reports = []
    for budget in (None, 0.0005):
        effects = Effects(bone_with_tissues(), seed=1, parameters=parameters, nozzle=nozzle, budget=budget)
        for _ in range(60):
            effects.step(0.05)
            assert effects.balance()["water"].exact
        reports.append(effects.report())
    assert reports[0].coarse == reports[0].crowded == reports[0].over_budget == 0
    assert (reports[1].coarse > 0, reports[1].parcels_most < reports[0].parcels_most) == (True, True)


def test_a_recorded_session_and_one_that_goes_back(tmp_path: Path) -> None:
    """Parcels are the same each time, water lasts as long as the trace, and bone that is restored buries no parcel."""
    ended(session(0.98, record=tmp_path / "trace.h5"))
    trace, parcels = load_trace(tmp_path / "trace.h5"), []
    for _ in range(2):
        player = TracePlayer(trace)
        effects = Effects(player.bone, seed=1, nozzle=WATER)
        assert [
            *effects_of(player, effects),
            effects.balance()["water"].made * effects.quantum / WATER.rate,
        ] == pytest.approx([*np.arange(1, 20) * 0.05, 0.98, 0.98])
        parcels.append(effects.parcels)
        assert effects.balance()["dust"].made == levels_removed(player.bone) > 0
    assert (parcels[0] == parcels[1]).all()
    refused(
        (lambda: effects_of(player, effects, rate=0), "rate must be positive"),
        (lambda: effects_of(trace, effects), "player must be a TracePlayer, such as", TypeError),
    )
    bricks = player.seek(0)
    effects.step(0.05, {"bricks": bricks, "density": _core.read_bricks(player.bone, bricks)})
    assert effects.balance()["dust"].exact
    assert not buried_parcels(effects, player.bone)


def test_hidden_fraction() -> None:
    opaque = EffectParameters(water_opacity=1.0, water_parcel=1000.0, gravity=0.0)
    effects = Effects(
        bone_with_tissues(), seed=1, parameters=opaque,
        nozzle=Nozzle((0, 0, 6), (0, 0, 1), rate=20000, speed=0, burr=None),
    )  # fmt: skip
    camera, burr = Camera((0, 0, 60), (0, 0, 0), up=(0, 1, 0)), ((0, 0, 1.8), 2.0)
    assert effects.hidden_fraction(camera, burr) == 0
    effects.camera = camera
    effects.step(0.05)
    assert np.isnan(effects.hidden)  # no burr
    assert effects.parcels["radius"].max() > 4
    assert effects.hidden_fraction(camera, burr) == 1
    assert np.isnan(effects.hidden_fraction(Camera((0, 0, 60), (0, 0, 100), up=(0, 1, 0)), burr))


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: EffectParameters(sub_steps=0), "sub_steps must be a whole number from 1 to 64, got 0"),
        (lambda: EffectParameters(dust_bulking=0.5), "dust_bulking must be from 1 to 100, got 0.5"),
        (
            lambda: EffectParameters(gravity=float("nan")),
            "gravity must be from 0 to 1e\\+06 mm/s\\^2, got nan",
        ),
        (lambda: Nozzle((0, 0, 0), (0, 0, 0)), "length of direction of the nozzle must be positive"),
        (lambda: Nozzle((0, 0, 0), rate=-1), "rate of the nozzle must be zero or positive"),
        (lambda: Nozzle((0, 0, 0), burr=-1), "burr of the nozzle must be 0, 1 or None"),
        (lambda: Sucker((0, 0, 0), radius=0), "radius of the sucker must be positive"),
        (lambda: Sucker((0, 0, 0), reach=1), "reach of the sucker must be at least its radius"),
        (lambda: Camera((0, 0, 0), (0, 0, 0)), "distance of look_at from the camera must be positive"),
        (lambda: Camera((0, 0, 9), (0, 0, 0)), "sine of the angle between up and the view"),
        (lambda: Camera((9, 0, 0), (0, 0, 0), view_angle=0), "view_angle must be from 1 to 170 degrees"),
        (lambda: Effects(bone_with_tissues(), budget=0), "budget must be positive"),
        (lambda: Effects(bone_with_tissues(), seed=-1), "seed must be a whole number from 0"),
        (lambda: Effects(bone_with_tissues(), down=(0, 0, 0)), "length of down must be positive"),
        (lambda: Nozzle((0, 0, 0), rate=1.1e6), r"rate of the nozzle must be at most 1e6 mm\^3/s"),
        (lambda: Nozzle((0, 0, 0), speed=1.1e6), "speed of the nozzle must be at most 1e6 mm/s"),
        (
            lambda: Nozzle((0, 0, 0), (0, 0, 1e200)),
            "length of direction of the nozzle must be positive and finite",
        ),
        *(
            (lambda call=call: call(Effects(bone_with_tissues(), seed=1)), told)
            for call, told in [
                (lambda e: e.step(0), "dt_s must be above 0 and at most 10 s, got 0"),
                (
                    lambda e: e.step(0.05, {"bricks": [[0, 0, 8]], "density": TILE}),
                    "bricks must lie inside the",
                ),
                (lambda e: e.step(0.05, {"bricks": [9999], "density": TILE}), "every brick must be below"),
                (
                    lambda e: e.step(0.05, {"bricks": [1, 2], "density": TILE}),
                    "density must hold 512 levels a brick",
                ),
                (lambda e: e.step(0.05, None, [((0, 0, 0), -1.0)]), "radius of a burr must be positive"),
                (lambda e: e.step(0.05, None, [((0, 0, np.nan), 1.0)]), "center of a burr must be finite"),
                (lambda e: e.step(0.05, None, [((0, 0), 1.0)]), "burrs must be"),
                (
                    lambda e: hide(e, (0, 0, 2), 2.0),
                    "distance of the camera from the burr must be above its radius",
                ),
                (lambda e: hide(e, (0, 0, 60), 0.0), "radius of the burr must be positive"),
                (
                    lambda e: e.step(0.05, decision=(100, 65, 1)),
                    "sub_steps of a decision must be at most 64, got 65",
                ),
            ]
        ),
        (lambda: of_block(9e3, 1e3), "volume of a voxel / 255 must be"),
        (lambda: of_block(9e-4, 1e-4), "volume of a voxel / 255"),
        (
            lambda: of_block(1, 0.1, origin=(0, 5e8, 0)),
            "distance of the bone's origin from 0 must be at most 1e9 voxels",
        ),
    ],
)
def test_refusals(make, sentence: str) -> None:
    refused((make, sentence))


def test_what_is_refused_makes_no_frame_and_an_unknown_parameter_no_effects() -> None:
    effects = Effects(bone_with_tissues(), seed=1)
    refused((lambda: effects.step(0.05, decision=(100, 2, 3)), "done of a decision"))
    assert effects.report().frames == 0
    refused(
        (lambda: EffectParameters(dust_rate=1.0), "no parameter 'dust_rate'", TypeError),
        (
            lambda: Effects(bone_with_tissues(), nozzle=3),
            "nozzle must be a Nozzle, such as Nozzle",
            TypeError,
        ),
    )


def hide(effects: Effects, place, radius: float) -> float:
    return effects.hidden_fraction(Camera(place, (0, 0, 0), up=(0, 1, 0)), ((0, 0, 1.8), radius))


def of_block(side: float, voxel: float, **place) -> Effects:
    return Effects(VoxelBone.block((side,) * 3, voxel, **place), seed=1)


def test_parameters_are_documented_and_kept() -> None:
    text = (Path(__file__).parents[2] / "docs" / "effects.md").read_text()
    for name, unit, _, _, assumed in EffectParameters.table():
        row = next((line for line in text.splitlines() if line.startswith(f"| `{name}` ")), "")
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        assert cells[1:3] == [f"{EffectParameters().to_dict()[name]:g}", unit], name
        assert cells[3] == ("assumed" if assumed else ""), name
    some = EffectParameters(blood_rate=0.2, sub_steps=3)
    assert pickle.loads(pickle.dumps(some)) == some != EffectParameters()
    assert repr(some) == "EffectParameters(blood_rate=0.2, sub_steps=3)"


# ---- extreme numbers ----


def frames(center=(0.0, 0.0, 1.5), radius=2.0, count=20, parameters=None, **instruments) -> Effects:
    """Effects of one cut, all of which is in the first of the frames."""
    bone = bone_with_tissues()
    after = bone.copy()
    contact = BurrContact(after, *TOOL, seed=1)
    for x in np.linspace(-1.5, 1.5, 60):
        contact.step((x, 0.0, 1.5), 1.0)
    bricks = _core.take_changed_bricks(after)
    update = {"bricks": bricks, "density": _core.read_bricks(after, bricks)}
    effects = Effects(bone, seed=1, parameters=parameters, **instruments)
    for i in range(count):
        effects.step(0.05, None if i else update, [(center, radius)])
    _core.restore_bricks(bone, update["bricks"], update["density"])
    accounts = effects.balance()
    assert accounts["dust"].made == levels_removed(after) > 0
    assert all(account.exact for account in accounts.values())
    parcels = effects.parcels
    assert np.isfinite([parcels["position"], parcels["velocity"]]).all()
    assert not buried_parcels(effects, bone)
    return effects


@pytest.mark.parametrize("far", [1e9, 1e100, 1e160, 1e308])
def test_a_burr_that_its_device_sent_far_away(far) -> None:
    """The length of its way overflows a double; the search of dust for a free place must still end."""
    frames((far, 0.0, 1.5))
    frames((-far, far, far), nozzle=Nozzle((0, 0, 3), rate=100, burr=0))
    frames(radius=far)


def test_a_session_whose_device_jumps_far_away() -> None:
    times = np.array([0.0, 0.1, 0.1001, 0.3, 0.3001, 0.4])
    x = np.array([0.0, 0.5, 1e200, -1e200, 0.5, 0.5])
    device = ScriptedDevice(times, np.stack([x, 0 * x, 0 * x + 1.5], axis=1))
    run = Session(bone_with_tissues(), TOOL, device, seed=1, clock=Clock(realtime=False))
    with Companion(run, seed=1, rate=50) as companion, run:  # bone gone before makes no dust
        assert run.wait(60)
        assert companion.wait(60)
    assert companion.error == ""
    assert companion.balance()["dust"].made == levels_removed(run.snapshot()[0]) > 0


@pytest.mark.parametrize(
    "sucker",
    [
        Sucker((0, 2, 1), pull=1e308),
        Sucker((1e308, 2, 1), reach=1e308, radius=1e300, rate=1e308),
        Sucker((0, 2, 1), radius=1e-300, reach=1e308, pull=1e308),
    ],
)
def test_suckers_of_any_size(sucker) -> None:
    frames(sucker=sucker)


def test_thousands_of_parcels_at_one_point_in_the_bone() -> None:
    nozzle = Nozzle((0, 0, -1), (0, 0, -1), rate=50_000, speed=0, burr=None)
    effects = frames(nozzle=nozzle, parameters=EffectParameters(water_spread=0.0, water_parcel=0.01))
    assert len(effects.parcels) > 5000
    few = frames(nozzle=nozzle, parameters=EffectParameters(most_parcels=16))  # merged, and none is dropped
    assert len(few.parcels) <= 16
    assert few.report().merged > 0


@pytest.mark.parametrize(("rate", "speed"), [(1e6, 0.0), (1e6, 1e6), (0.0, 1e6)])
def test_the_largest_nozzles(rate, speed) -> None:
    effects = frames(nozzle=Nozzle((0, 0, 5), (0, 0.1, -1), rate=rate, speed=speed, burr=None))
    assert effects.balance()["water"].made == pytest.approx(rate * 1.0 / effects.quantum, abs=2.0)


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 9, 1), (2, 1, 17)])
def test_a_bone_of_few_voxels(shape) -> None:
    bone = VoxelBone(np.full(shape, 255, np.uint8), 0.1)
    effects = Effects(bone, seed=1, nozzle=Nozzle((0, 0, 3), (0, 0, -1), rate=100, burr=None))
    bricks = np.arange(np.prod([-(-n // 8) for n in shape]), dtype=np.uint32)
    effects.step(
        0.05, {"bricks": bricks, "density": np.zeros((len(bricks), 512), np.uint8)}, [((0, 0, 0), 1.0)]
    )
    for _ in range(40):
        effects.step(0.05)
    assert effects.balance()["dust"].made == 255 * np.prod(shape)
    assert all(account.exact for account in effects.balance().values())
