"""Values that are no numbers, names or ports are refused, and never converted to others."""

import numpy as np
import pytest
from session_scenes import session_of

import burrlab
from burrlab._core import Burr, EffectParameters, Material, Tissue, VoxelBone
from burrlab.bone.image import OccupancyMap
from burrlab.bone.phantom.phantom import temporal_bone
from burrlab.effects.effects import Effects
from burrlab.session.network import block_recipe, follow

BONE, BURR = burrlab.materials["bone"], Burr(1.5)
VOLUME = burrlab.Volume(np.zeros((3, 3, 3)), (1, 1, 1), (0, 0, 0), np.eye(3), "made")
LEVELS = np.ones((2, 2, 2), np.uint8)


def session(**options: object) -> burrlab.Session:
    return session_of(
        VoxelBone.block((4, 4, 3), 0.2), (Burr(1.0), BONE), burrlab.HandDevice((2, 2, 3.5)), wall_clock=False, **options
    )  # fmt: skip


NUMBERS = {
    "radius": Burr, "c_e": lambda v: Material("m", c_e=v, alpha=0.1), "voxel": lambda v: VoxelBone.block((1, 1, 1), v),
    "rate": lambda v: session(rate=v), "force_limit": lambda v: session(force_limit=v), "seed": lambda v: session(seed=v),
    "publish": lambda v: session(publish=v), "duration": lambda v: session(duration=v), "watch": lambda v: session(watch=v),
    "port": lambda v: follow("127.0.0.1", v, timeout=0.1), "timeout": lambda v: follow("127.0.0.1", 1, timeout=v),
    "block_recipe": lambda v: block_recipe((1, 1, 1), v), "map": lambda v: OccupancyMap.two_point(0, v),
    "spacing": lambda v: VOLUME.resample(v), "force": lambda v: burrlab.descend(BURR, BONE, v, ideal=True),
    "stop": lambda v: burrlab.descend(BURR, BONE, 1.0, settings=burrlab.DescentSettings(stop=v)), "forces": lambda v: burrlab.synthetic_curve(BURR, BONE, [v]),
    "repeats": lambda v: burrlab.synthetic_curve(BURR, BONE, [1, 2], repeats=v), "effects": lambda v: Effects(VOLUME, seed=v),
    "gravity": lambda v: EffectParameters(gravity=v), "phantom": lambda v: temporal_bone(v, seed=1),
    "curve": lambda v: burrlab.VelocityCurve(force=[1, 2], velocity=[1, 2], radius=v),
}  # fmt: skip
PLACES = {
    "hand": burrlab.HandDevice, "mailbox": lambda v: burrlab.MailboxDevice().put(v), "axis": lambda v: burrlab.half_space(BURR, 0.3, axis=v),
    "script": lambda v: burrlab.ScriptedDevice([0, 1], [(0, 0, 0), v]), "block": lambda v: VoxelBone.block(v, 0.2),
    "bone": lambda v: VoxelBone(LEVELS, 0.2, origin=v), "volume": lambda v: burrlab.Volume(VOLUME.values, 1, v, np.eye(3), "p"),
    "crop": lambda v: VOLUME.crop(v, (2, 2, 2)), "entry": lambda v: burrlab.surface_along(VoxelBone(LEVELS, 0.2), v, (0, 0, 1)),
    "erode": lambda v: burrlab.erode(VoxelBone.block((4, 4, 3), 0.2), Burr(1), v, BONE, dt=1.0, seed=1, tick=0),
}  # fmt: skip
NAMES = {
    "material": lambda v: Material(v, c_e=1, alpha=0), "tissue": lambda v: Tissue(v, label=1, c_e=1, alpha=0),
    "label": lambda v: burrlab.LabelVolume(LEVELS, 1, (0, 0, 0), np.eye(3), "p", {1: v}),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore")  # NumPy warns when it drops imaginary parts
@pytest.mark.parametrize(
    ("take", "value"),
    [(take, value) for take in NUMBERS.values() for value in (10**400, 1 + 2j, np.complex128(1 + 2j), True, b"x")]
    + [(take, (value, 0, 1)) for take in PLACES.values() for value in (10**400, 1 + 2j, np.complex64(1), b"x")]
    + [(take, value) for take in NAMES.values() for value in (10**400, 1j, True, b"x")],
)  # fmt: skip
def test_what_is_no_number_place_or_name_is_refused(take, value) -> None:
    with pytest.raises((TypeError, ValueError)):
        take(value)
