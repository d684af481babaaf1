"""Records for tests of traces, made by contacts instead of the loop or the executor, and a reader of them."""

import contextlib
from dataclasses import fields

import numpy as np
import pytest

from burrlab import (
    Burr,
    BurrContact,
    Clock,
    Publish,
    Safety,
    Session,
    StartingBone,
    VoxelBone,
    _core,
    load_trace,
    materials,
)
from burrlab.session.recorder import TraceWriter

SEED = 7


def session_of(bone, tools, devices, *, frames=None, **options):
    """A session whose settings stand in one row, and of whose devices each stands in the same frame."""

    def settings(kind, *arguments):
        names = {field.name for field in fields(kind)} & options.keys()
        return kind(*arguments, **{name: options.pop(name) for name in names})

    options["port"] = options.pop("publish", None)
    if frames is not None:
        devices = [(device, frames) for device in (devices if isinstance(devices, tuple) else [devices])]
    begin = settings(StartingBone, bone) if isinstance(bone, VoxelBone) else bone
    publish = settings(Publish)
    return Session(
        begin, tools, devices, clock=settings(Clock), safety=settings(Safety),
        publish=None if publish.port is publish.vrpn is None else publish, **options,
    )  # fmt: skip


def small_bone():
    """12 x 12 x 4 mm at 0.2 mm, top at z = 0, eroded at one place."""
    bone = VoxelBone.block((12, 12, 4), 0.2, origin=(-5.9, -5.9, -3.9))
    worn = BurrContact(bone, Burr(1.0), materials["bone"], seed=1)
    for _ in range(50):
        worn.step((2.0, 1.0, 0.5), 1.0)
    return bone


def tools(burrs=1):
    pairs = (2.0, "bone"), (1.5, "pettigrew")
    return [(Burr(radius), materials[name]) for radius, name in pairs[:burrs]]


def path(tick, burr):
    """Place of a burr that sinks: the first strokes along x, the second along y."""
    s, depth = 2.0 * np.sin(2 * np.pi * tick / 700), min(0.3, 0.0004 * tick)
    return (s, -2.5, 2.0 - depth) if burr == 0 else (2.5, s, 1.5 - depth)


def make_records(bone, n, *, burrs=1, first=0, seed=SEED):
    """n ticks of 1 ms that carve `bone`, one contact a burr; some ticks have k = 3 or a burr at rest."""
    contacts = [
        BurrContact(bone, burr, material, seed, index) for index, (burr, material) in enumerate(tools(burrs))
    ]
    records = np.zeros(n, _core.record_dtype)
    for i in range(n):
        record, tick = records[i], first + i
        k = 3 if tick % 97 == 5 else 1
        record["index"], record["k"], record["burrs"] = tick, k, burrs
        record["time"], record["cpu_time"] = 0.001 * i, 12.5
        for j, contact in enumerate(contacts):
            at, on = path(tick, j), tick % 211 < 180
            contact.tick = tick
            met = contact.step(at, float(k), on)
            b = record["burr"][j]
            b["center"], b["radius"], b["material"], b["on"] = at, tools(burrs)[j][0].radius, j, on
            b["touching"], b["ambiguous"] = met.touching, met.ambiguous
            b["force"], b["penetration"] = met.force, met.penetration
            b["removed"] = round(met.removed / 0.2**3 * 255)
            b["sent"], b["device_position"] = met.force * 0.5, at
            b["device_velocity"], b["age"] = (1.0, 2.0, 3.0), 0.25
            b["orientation"], b["buttons"] = (np.cos(i), 0.0, 0.6 * np.sin(i), 0.8 * np.sin(i)), i % 4
    return records


@pytest.fixture(name="records", scope="module")
def many_records():
    return make_records(small_bone(), 1500, first=40)


@pytest.fixture(name="file")
def session_file(tmp_path):
    return tmp_path / "session.h5"


class FakeReader:
    """Returns the records it was fed; reports lost ones at the end if told to."""

    def __init__(self, *batches, lost_at_end=False):
        self.batches = list(batches)
        self.lost_at_end = lost_at_end

    def feed(self, records):
        self.batches.append(records)

    def take(self, most=100_000):
        if not self.batches:
            return np.zeros(0, _core.record_dtype), self.lost_at_end
        batch = self.batches.pop(0)
        if len(batch) > most:
            self.batches.insert(0, batch[most:])
        return batch[:most], False


def writer(file, *batches, burrs=1, reader=None, **options):
    """A recorder of batches of records, or of a reader, not started."""
    first = int(batches[0]["index"][0]) if batches and len(batches[0]) else 40
    settings = {"seed": SEED, "first_tick": first, **options}
    return new_writer(file, reader or FakeReader(*batches), small_bone(), tools(burrs), **settings)


def new_writer(file, reader, bone, tools, **settings):
    room = {name: settings.pop(name) for name in ("duration", "digest_every", "on_end") if name in settings}
    about = {
        "rate_Hz": 1e3 / settings.pop("period", 1.0), "scheme": "layer", "first_tick": 0, "devices": [""] * len(tools),
        "source": {}, **settings,
    }  # fmt: skip
    return TraceWriter(file, reader, bone, tools, about, **room)


def record(file, *batches, **options):
    """A `writer`, run to its end."""
    made = writer(file, *batches, **options)
    made.start()
    made.stop()
    return made


def recorded(file, *batches, **options):
    """The trace of a `record`."""
    record(file, *batches, **options)
    return load_trace(file)


def refused(*rows, error=ValueError):
    """Each call of the rows (call, words, perhaps another error) is refused in these words."""
    for call, words, *others in rows:
        with pytest.raises(*(others or [error]), match=words):
            call()


@contextlib.contextmanager
def file_size_limit(size):
    """Files of this process are at most so large [bytes], as on a full disk."""
    resource = pytest.importorskip("resource", reason="limits of a process are POSIX")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def ended(session):
    """The session after its end."""
    with session:
        assert session.wait(120)
    return session
