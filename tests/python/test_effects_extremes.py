"""Secondary effects with extreme numbers: they end, values stay finite, and the accounts hold."""

import numpy as np
import pytest
from effects_scenes import TOOL, bone_with_tissues, buried_parcels, levels_removed

from burrlab import BurrContact, Clock, ScriptedDevice, Session, VoxelBone, _core
from burrlab.effects import Companion, EffectParameters, Effects, Nozzle, Sucker


def cut():
    """(bone before a cut, the cut as an update, levels removed)"""
    bone = bone_with_tissues()
    after = bone.copy()
    contact = BurrContact(after, *TOOL, seed=1)
    for x in np.linspace(-1.5, 1.5, 60):
        contact.step((x, 0.0, 1.5), 1.0)
    bricks = _core.take_changed_bricks(after)
    return bone, {"bricks": bricks, "density": _core.read_bricks(after, bricks)}, levels_removed(after)


def frames(center=(0.0, 0.0, 1.5), radius=2.0, count=20, parameters=None, **instruments) -> Effects:
    bone, update, removed = cut()
    effects = Effects(bone, seed=1, parameters=parameters, **instruments)
    for i in range(count):
        effects.step(0.05, None if i else update, [(center, radius)])
    _core.restore_bricks(bone, update["bricks"], update["density"])
    accounts = effects.balance()
    assert accounts["dust"].made == removed > 0
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
    session = Session(bone_with_tissues(), TOOL, device, seed=1, clock=Clock(realtime=False))
    with Companion(session, seed=1, rate=50) as companion, session:  # bone gone before makes no dust
        assert session.wait(60)
        assert companion.wait(60)
    assert companion.error == ""
    assert companion.balance()["dust"].made == levels_removed(session.snapshot()[0]) > 0


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
    assert len(frames(nozzle=nozzle, parameters=EffectParameters(most_parcels=16)).parcels) <= 16


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
