"""Recipes and hellos, and their refusals."""

import json

import numpy as np
import pytest
from replica_scenes import BLOCK, Leader, soon
from scipy.spatial.transform import Rotation
from session_scenes import refused

from burrlab import (
    Burr,
    Clock,
    IgtlDevice,
    MailboxDevice,
    Publish,
    ReplayDevice,
    Session,
    StartingBone,
    VoxelBone,
    _core,
    load_trace,
    materials,
)
from burrlab.session.network import block_recipe, follow, make_bone, open_publisher


@pytest.fixture(scope="module")
def leader():
    with Leader() as leader:
        yield leader


def test_block_recipe_survives_json():
    recipe = json.loads(json.dumps(block_recipe((3, 2, 1), 0.1, origin=(0.1, 1 / 3, -1e-9), level=200)))
    bone = VoxelBone.block((3, 2, 1), 0.1, origin=(0.1, 1 / 3, -1e-9), level=200)
    assert make_bone(recipe).digest() == bone.digest()


def test_hello_of_a_leader(leader):
    replica = _core.Replica("127.0.0.1", leader.port)
    assert replica.session == 0
    assert replica.fetch_hello()
    assert json.loads(replica.hello) == leader.hello
    assert replica.session == leader.publisher.session != 0
    assert (replica.first_tick, replica.initial_digest) == (0, make_bone(BLOCK).digest())


def test_follow_with_a_bone_given(leader):
    bone = make_bone(BLOCK)
    replica = follow("127.0.0.1", leader.port, bone=bone)
    assert soon(lambda: replica.status["tick"] > 700)
    replica.stop()
    assert bone.digest() == replica.initial_digest != replica.digest()


def test_follow_needs_a_recipe():
    with Leader(source=None) as leader, pytest.raises(ValueError, match="bone must be given: the leader at"):
        follow("127.0.0.1", leader.port)


ALONE = _core.Replica("127.0.0.1", 1)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        *((lambda _, recipe=recipe: make_bone(recipe), "recipe must be that of block_recipe or volume_recipe, got") for recipe in [
            {}, {"kind": "sphere"}, {"kind": "volume"},
            *(BLOCK | change
              for change in ({"size_mm": None}, {"size_mm": [1, 1, 1, 1]}, {"level": 256}, {"level": 10**30}, {"level": np.inf}, {"levl": 9})),
            *({"kind": "volume", "path": "v.nrrd", "map": [0, 1]} | change
              for change in ({"map": []}, {"map": [[0, 1]]}, {"map": "ab"}, {"map": [1, 0]}, {"voxel_mm": [1, 2]},
                             {"crop_mm": [[1, 2, 3]]}, {"path": 3})),
        ]),
        (lambda _: make_bone(block_recipe((1000, 1000, 1000), 0.1)),
         r"recipe must have at most 2e\+08 voxels, got 1e\+12"),
        *((lambda _, where=where, seconds=seconds: follow(*where, timeout=seconds), sentence) for where, seconds, sentence in [
            (("127.0.0.1", 0), 0.1, "port must be 1 to 65535, got 0"),
            (("no such host", 1), 0.1, "host must be a name or an address that can be looked up"),
            (("127.0.0.1", 1), 0.1, "no leader answers at 127.0.0.1:"),
            (("127.0.0.1", 1), 0.0, "timeout must be positive, got 0.0"),
            (("127.0.0.1", 1), float("nan"), "timeout must be positive, got nan"),
        ]),
        *((lambda leader, options=options: _core.Publisher(leader.follower, **options), sentence) for options, sentence in [
            ({"port": 70000}, "port must be 0 to 65535, got 70000"),
            ({"host": "no such host"}, "host must be an address of this machine, got 'no such host'"),
            ({"host": "192.0.2.1"}, "host and port must be free to listen on, got 192.0.2.1:0"),
            ({"header_version": 3}, "header_version must be 1 or 2, got 3"),
            ({"log": 0.0}, "log must be positive and finite, got 0"),
            ({"log": 1e9}, "ticks of the log must be at most 2000000"),
            ({"hello": " " * 900_001}, "length of hello must be at most 900000 bytes"),
            ({"most_peers": 0}, "most_peers must be 1 to 256, got 0"),
            ({"most_behind": 10}, "most_behind must be at least 1024 bytes, got 10"),
            ({"thin_after": 0}, "thin_after must be 1 to 1023 ticks, got 0"),
        ]),
        (lambda leader: _core.Publisher(leader.follower, port=leader.port),
         "free to listen on, got 127.0.0.1:"),
        *((lambda leader, name=name: open_publisher(leader.follower, {key: leader.hello[key] for key in leader.hello if key != name}, Publish()),
           f"hello must hold .*, got none of {name}") for name in ("seed", "rate_Hz", "scheme", "tools")),
        (lambda leader: open_publisher(leader.follower, {**leader.hello, "force": float("nan")}, Publish()), "hello must be what JSON holds"),
        (lambda leader: leader.publisher.finish("done", linger=-1.0),
         "linger must be zero or positive and finite, got -1"),
        (lambda leader: follow("127.0.0.1", leader.port, bone=make_bone({**BLOCK, "level": 254})),
         r"bone must be the leader's initial volume, digest .*, got"),
        (lambda leader: ALONE.start(make_bone(BLOCK), leader.tools, 1),
         "hello must be fetched before the replica is started"),
        (lambda leader: ALONE.digest(), "replica must be started first"),
        (lambda leader: ALONE.fetch_hello(0.0), "timeout must be positive"),
    ],
)  # fmt: skip
def test_refusals(leader, call, sentence):
    with pytest.raises(ConnectionError if "answers" in sentence else ValueError, match=sentence):
        call(leader)


def test_replica_is_started_once(leader):
    replica = follow("127.0.0.1", leader.port)
    refused(
        (
            lambda: replica.start(make_bone(BLOCK), leader.tools, 7),
            "replica must be started once: it has been",
        ),
        (replica.fetch_hello, "hello must be fetched before the replica is started"),
    )
    replica.stop()


def test_orientation_and_buttons_survive_the_way(tmp_path):
    """From a device to a trace and a replica to the bit, over TRANSFORM to another session as float32."""
    random = np.random.default_rng(1)
    turned = random.normal(size=(3000, 4))
    turned /= np.linalg.norm(turned, axis=1)[:, None] * np.where(turned[:, :1] < 0, -1, 1)  # w >= 0
    buttons = random.integers(0, 256, 3000)
    place = np.tile([0.0, 0.0, 2.9], (3000, 1))
    device = ReplayDevice(place, orientation=turned, buttons=buttons)
    tool = Burr(3.0), materials["bone"]
    path = tmp_path / "turned.h5"
    with Session(
        StartingBone(make_bone(BLOCK), source=BLOCK),
        tool,
        device,
        seed=1,
        publish=0,
        record=path,
        clock=Clock(realtime=False),
    ) as session:
        replica = follow("127.0.0.1", session.port)
        seen = {}
        onward = IgtlDevice("127.0.0.1", session.port, device_name="burrlab_burr_0", lost_after=1000.0)
        with Session(
            make_bone(BLOCK),
            tool,
            onward,
            seed=1,
            record=tmp_path / "onward.h5",
            clock=Clock(realtime=False),
        ):
            while not session.wait(0.01):
                if (newest := replica.take()["newest"]) is not None:
                    seen[int(newest["index"])] = newest["burr"][0].copy()
    replica.stop()
    trace, far = load_trace(path), load_trace(tmp_path / "onward.h5")
    np.testing.assert_array_equal(trace.array("orientation"), turned[: len(trace)])
    np.testing.assert_array_equal(trace.array("buttons"), buttons[: len(trace)])
    assert len(seen) > 20
    for tick, burr in seen.items():
        assert (burr["orientation"].tolist(), burr["buttons"]) == (turned[tick].tolist(), buttons[tick])
    came, sent = (
        Rotation.from_quat(np.roll(quaternions, -1, axis=1)).as_matrix()
        for quaternions in (far.array("orientation"), turned)
    )
    apart = np.abs(came[::50, None] - sent).max(axis=(2, 3)).min(axis=1)
    assert len(apart) > 5
    assert apart.max() < 1e-6
    length = "length of orientation must be 1, got"
    refused(
        (lambda: MailboxDevice().put((0, 0, 0), orientation=(0, 0, 0, 0)), f"{length} 0"),
        (lambda: ReplayDevice(place, orientation=turned * np.nan), f"{length} nan"),
    )
