"""Recipes and hellos, and what is refused with a sentence."""

import json
import socket

import pytest
from replica_scenes import BLOCK, Leader, soon

import burrlab
import burrlab._core as _core
from burrlab.session.network import block_recipe, follow, make_bone, open_publisher, volume_recipe


@pytest.fixture
def leader():
    with Leader() as leader:
        yield leader


def test_block_recipe_survives_json():
    recipe = json.loads(json.dumps(block_recipe((3, 2, 1), 0.1, origin=(0.1, 1 / 3, -1e-9), level=200)))
    bone = burrlab.VoxelBone.block((3, 2, 1), 0.1, origin=(0.1, 1 / 3, -1e-9), level=200)
    assert make_bone(recipe).digest() == bone.digest()


def test_volume_recipe(tmp_path):
    sitk = pytest.importorskip("SimpleITK")
    np = pytest.importorskip("numpy")
    image = sitk.GetImageFromArray(np.random.default_rng(1).integers(0, 1000, (9, 10, 11), dtype=np.int16))
    for name in ("here.nrrd", "there.nrrd"):
        sitk.WriteImage(image, str(tmp_path / name))
    recipe = volume_recipe(tmp_path / "here.nrrd", 100, 900)
    bone = burrlab.read_volume(tmp_path / "there.nrrd").to_bone(100, 900)
    assert make_bone(json.loads(json.dumps(recipe))).digest() == bone.digest()
    (tmp_path / "here.nrrd").unlink()
    assert make_bone(recipe, volume=tmp_path / "there.nrrd").digest() == bone.digest()
    with pytest.raises(FileNotFoundError, match=r"here\.nrrd: no such file"):
        make_bone(recipe)


@pytest.mark.parametrize(
    "recipe",
    [
        {},
        {"kind": "sphere"},
        {"kind": "volume"},
        {**BLOCK, "size_mm": None},
        {**BLOCK, "size_mm": [1, 2]},
        {**BLOCK, "level": 256},
        {**BLOCK, "level": 10**30},
        {**BLOCK, "level": float("inf")},
    ],
)
def test_recipe_that_cannot_be_read(recipe):
    with pytest.raises(ValueError, match="recipe must be that of block_recipe or volume_recipe, got"):
        make_bone(recipe)


def test_recipe_too_large_to_make():
    with pytest.raises(ValueError, match="recipe must have at most 2e\\+08 voxels, got 1e\\+12"):
        make_bone(block_recipe((1000, 1000, 1000), 0.1))


def test_hello_of_a_leader(leader):
    replica = _core.Replica("127.0.0.1", leader.port)
    assert replica.session == 0
    assert replica.fetch_hello()
    assert json.loads(replica.hello) == leader.hello
    assert replica.session == leader.publisher.session != 0
    assert replica.first_tick == 0
    assert replica.initial_digest == make_bone(BLOCK).digest()


@pytest.mark.parametrize(
    ("host", "port", "options", "error", "told"),
    [
        ("127.0.0.1", 0, {}, ValueError, "port must be 1 to 65535, got 0"),
        ("no such host", 1, {}, ValueError, "host must be a name or an address that can be looked up"),
        ("127.0.0.1", None, {}, ConnectionError, "no leader answers at 127.0.0.1:"),
        ("127.0.0.1", None, {"timeout": 0.0}, ValueError, "timeout must be positive, got 0.0"),
    ],
)
def test_follow_needs_an_address(host, port, options, error, told):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1] if port is None else port
    with pytest.raises(error, match=told):
        follow(host, port, **{"timeout": 0.1, **options})


def test_follow_needs_the_same_bone(leader):
    other = make_bone({**BLOCK, "level": 254})
    with pytest.raises(ValueError, match=r"bone must be the leader's initial volume, digest .*, got"):
        follow("127.0.0.1", leader.port, bone=other)


def test_follow_with_a_bone_given(leader):
    bone = make_bone(BLOCK)
    replica = follow("127.0.0.1", leader.port, bone=bone)
    assert soon(lambda: replica.status["tick"] > 700)
    replica.stop()
    assert bone.digest() == replica.initial_digest != replica.digest()


def test_follow_needs_a_recipe():
    with Leader(source=None) as leader, pytest.raises(ValueError, match="bone must be given: the leader at"):
        follow("127.0.0.1", leader.port)


def test_follow_needs_a_hello_that_can_be_read(leader):
    follower = _core.Follower(_core.HapticLoop(leader.executor, [burrlab.HandDevice()]))
    good = '{"seed": 1, "rate_Hz": 1000, "scheme": "layer", "tools": []}'
    bad = [good.replace("1,", f"{seed},", 1) for seed in (-1, 2**64, 1.5, "null")]
    bad += [
        good.replace("1000", "0"),
        good.replace('"layer"', '"layer", "source": 3'),
        "not JSON",
        "[" * 100_000,
    ]
    for text in ("[]", *bad):
        publisher = _core.Publisher(follower, hello=text)
        with pytest.raises(ValueError, match=r"hello of the leader at .* cannot be read"):
            follow("127.0.0.1", publisher.port)
        publisher.stop()


@pytest.mark.parametrize("missing", ["seed", "rate_Hz", "scheme", "tools"])
def test_publisher_needs_a_hello(leader, missing):
    hello = {name: value for name, value in leader.hello.items() if name != missing}
    with pytest.raises(ValueError, match=f"hello must hold .*, got none of {missing}"):
        open_publisher(leader.follower, hello)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
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
    ],
)
def test_publisher_refuses(leader, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        _core.Publisher(leader.follower, **options)


def test_port_in_use(leader):
    with pytest.raises(ValueError, match=f"free to listen on, got 127.0.0.1:{leader.port}"):
        _core.Publisher(leader.follower, port=leader.port)


def test_linger_must_not_be_negative(leader):
    with pytest.raises(ValueError, match="linger must be zero or positive and finite, got -1"):
        leader.publisher.finish("done", linger=-1.0)


def test_replica_needs_its_hello_first():
    replica = _core.Replica("127.0.0.1", 1)
    with pytest.raises(ValueError, match="hello must be fetched before the replica is started"):
        replica.start(make_bone(BLOCK), [(burrlab.Burr(3.0), burrlab.materials["bone"])], 1)
    with pytest.raises(ValueError, match="replica must be started first"):
        replica.digest()
    with pytest.raises(ValueError, match="timeout must be positive"):
        replica.fetch_hello(0.0)


def test_replica_is_started_once(leader):
    replica = follow("127.0.0.1", leader.port)
    with pytest.raises(ValueError, match="replica must be started once: it has been"):
        replica.start(make_bone(BLOCK), leader.tools, 7)
    with pytest.raises(ValueError, match="hello must be fetched before the replica is started"):
        replica.fetch_hello()
    replica.stop()


def test_volume_recipe_is_absolute(tmp_path, monkeypatch):
    """A replica is seldom run in the leader's folder."""
    monkeypatch.chdir(tmp_path)
    assert volume_recipe("here.nrrd", 0, 1)["path"] == str(tmp_path / "here.nrrd")


def test_hello_with_what_json_has_not():
    loop = _core.HapticLoop(
        _core.TickExecutor(make_bone(BLOCK), [(burrlab.Burr(3.0), burrlab.materials["bone"])], 1),
        [burrlab.HandDevice()],
    )
    hello = {"seed": 1, "rate_Hz": 1000.0, "scheme": "layer", "tools": [], "force": float("nan")}
    with pytest.raises(ValueError, match="hello must be what JSON holds"):
        open_publisher(_core.Follower(loop), hello)
