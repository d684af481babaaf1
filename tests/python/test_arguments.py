"""Values that are no numbers, names or ports are refused, and never converted to others."""

from functools import partial

import numpy as np
import pytest
from session_scenes import session_of

import burrlab
from burrlab._core import Burr, EffectParameters, Material, Tissue, VoxelBone
from burrlab.bone.phantom.phantom import temporal_bone
from burrlab.effects.effects import Effects
from burrlab.session.network import block_recipe, follow

BONE, BURR = burrlab.materials["bone"], Burr(1.5)
VOLUME = burrlab.Volume(np.zeros((3, 3, 3)), (1, 1, 1), (0, 0, 0), np.eye(3), "made")
LEVELS = np.ones((2, 2, 2), np.uint8)
LABELLED = partial(burrlab.LabelVolume, LEVELS, 1, (0, 0, 0), np.eye(3), "p")


def session(**options: object) -> burrlab.Session:
    return session_of(
        VoxelBone.block((4, 4, 3), 0.2), (Burr(1.0), BONE), burrlab.HandDevice((2, 2, 3.5)), wall_clock=False, **options
    )  # fmt: skip


REAL, WHOLE, PLACE = (
    "must be of real numbers that a float holds",
    "must be a whole number",
    "must be three numbers (x, y, z)",
)
PYBIND = "incompatible"  # the core takes an array and has no sentence of its own
#: The function, the argument that is wrong, the rule that it breaks, and the function's other arguments.
NUMBERS = [
    (Burr, "radius", "radius must be a number", {}),
    (Material, "c_e", "c_e must be a number", {"name": "m", "alpha": 0.1}),
    (VoxelBone.block, "spacing", "spacing must be a number or three of them", {"size": (1, 1, 1)}),
    (session, "rate", f"rate {REAL}", {}),
    (session, "force_limit", f"force_limit {REAL}", {}),
    (session, "duration", f"duration {REAL}", {}),
    (session, "seed", f"seed {WHOLE}", {}),
    (session, "publish", f"port {WHOLE}", {}),
    (session, "watch", "watch must be a Watch", {}),
    (follow, "port", f"port {WHOLE}", {"host": "127.0.0.1", "timeout": 0.1}),
    (follow, "timeout", f"timeout {REAL}", {"host": "127.0.0.1", "port": 1}),
    (block_recipe, "voxel", f"voxel {REAL}", {"size": (1, 1, 1)}),
    (burrlab.OccupancyMap.two_point, "solid", f"map {REAL}", {"empty": 0}),
    (VOLUME.resample, "spacing", f"spacing {REAL}", {}),
    (
        burrlab.descend,
        "force",
        "force must be a number|incompatible",
        {"burr": BURR, "material": BONE, "ideal": True},
    ),
    (burrlab.DescentSettings, "stop", f"stop {REAL}", {}),
    (burrlab.synthetic_curve, "forces", f"forces {REAL}", {"burr": BURR, "material": BONE}),
    (
        burrlab.synthetic_curve,
        "repeats",
        f"repeats {WHOLE}",
        {"burr": BURR, "material": BONE, "forces": [1, 2]},
    ),
    (Effects, "seed", f"seed {WHOLE}", {"bone": VOLUME}),
    (EffectParameters, "gravity", "gravity must be a number", {}),
    (temporal_bone, "voxel", f"voxel {REAL}", {"seed": 1}),
    (burrlab.VelocityCurve, "radius", f"radius {REAL}", {"force": [1, 2], "velocity": [1, 2]}),
]
PLACES = [
    (burrlab.HandDevice, "start", f"start {PLACE}", {}),
    (burrlab.MailboxDevice().put, "position", PYBIND, {}),
    (burrlab.ScriptedDevice, "position", PYBIND, {"time": [0]}),
    (burrlab.half_space, "axis", f"axis {REAL}", {"burr": BURR, "voxel": 0.3}),
    (VoxelBone.block, "size", f"size {PLACE}", {"spacing": 0.2}),
    (VoxelBone, "origin", f"origin {PLACE}", {"density": LEVELS, "spacing": 0.2}),
    (burrlab.Volume, "origin", f"origin {REAL}", {"values": VOLUME.values, "spacing": 1, "direction": np.eye(3), "path": "p"}),
    (VOLUME.crop, "low", f"low {REAL}", {"high": (2, 2, 2)}),
    (burrlab.surface_along, "entry", f"entry {REAL}", {"bone": VoxelBone(LEVELS, 0.2), "axis": (0, 0, 1)}),
    (burrlab.erode, "center", PYBIND,
     {"bone": VoxelBone.block((4, 4, 3), 0.2), "burr": Burr(1), "material": BONE, "dt": 1.0, "seed": 1, "tick": 0}),
]  # fmt: skip
NAMES = [
    (Material, "name", "name must be text", {"c_e": 1, "alpha": 0}),
    (Tissue, "name", "name must be text", {"label": 1, "c_e": 1, "alpha": 0}),
]
WRONG = 10**400, 1 + 2j, b"x"


@pytest.mark.filterwarnings("ignore")  # NumPy warns when it drops imaginary parts
@pytest.mark.parametrize(
    ("function", "argument", "rule", "others", "value"),
    [(*row, value) for row in NUMBERS for value in (*WRONG, np.complex128(1 + 2j), True)]
    + [(*row, (value, 0, 1)) for row in PLACES for value in (*WRONG, np.complex64(1))]
    + [(*row, value) for row in NAMES for value in (*WRONG, True)]
    + [(LABELLED, "names", "a name must be a str", {}, {1: value}) for value in (*WRONG, True)],
)  # fmt: skip
def test_what_is_no_number_place_or_name_is_refused(function, argument, rule, others, value) -> None:
    with pytest.raises((TypeError, ValueError), match=rule.replace("(", r"\(").replace(")", r"\)")):
        function(**others, **{argument: value})
