"""Threads may each erode a bone of their own, or all feel one; other uses of one bone at once are refused."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray

from burrlab import Burr, BurrContact, MailboxDevice, Material, Session, VoxelBone, _core

WORKERS = 6


@pytest.fixture(scope="module")
def fresh() -> VoxelBone:
    return VoxelBone(np.random.default_rng(4).integers(0, 256, (50, 60, 70)).astype(np.uint8), spacing=0.1)


def contact_on(bone: VoxelBone, worker: int) -> BurrContact:
    material = Material("any", c_e=2.0, alpha=0.3, shape="power(1.5)")
    return BurrContact(bone, Burr(1.5), material, seed=worker, scheme=("layer", "cell")[worker % 2])


@pytest.fixture
def contact(fresh: VoxelBone) -> BurrContact:
    """On a copy of its own."""
    return contact_on(fresh.copy(), 0)


def path(ticks: int) -> NDArray[np.float64]:
    t = np.linspace(0.0, 1.0, ticks)
    return np.stack([1.0 + 5.0 * t, 3.0 + np.sin(6.0 * t), 5.0 - 2.0 * t], axis=1)


def erode_a_copy(fresh: VoxelBone, worker: int, ready: threading.Barrier | None = None) -> tuple[str, float]:
    """Digest and removed volume after a run, steps, probes and erosions."""
    bone = fresh.copy()
    contact = contact_on(bone, worker)
    if ready is not None:
        ready.wait()
    contact.run(path(60), 1.0)
    for center in path(20):
        contact.step(center, 1.0)
        contact.probe(center)
        contact.erode(center, 1.0)
    return bone.digest(), bone.removed


def test_threads_on_copies_give_what_serial_runs_give(cpu_path: str, fresh: VoxelBone) -> None:
    digest = fresh.digest()
    alone = [erode_a_copy(fresh, worker) for worker in range(WORKERS)]
    assert len(set(alone)) == WORKERS
    ready = threading.Barrier(WORKERS)
    with ThreadPoolExecutor(WORKERS) as pool:
        assert list(pool.map(lambda worker: erode_a_copy(fresh, worker, ready), range(WORKERS))) == alone
    assert fresh.digest() == digest


def test_threads_may_feel_one_bone(cpu_path: str, contact: BurrContact) -> None:
    """Threads use one contact or several, and copy the bone, read levels and make digests meanwhile."""
    bone = contact.bone
    contact.run(path(40), 1.0)  # some bricks hold saved levels
    digest, density, pristine = bone.digest(), bone.density, bone.pristine
    ready = threading.Barrier(WORKERS)

    def feel(worker: int) -> list[list[float]]:
        own = contact if worker % 2 else contact_on(bone, 0)
        ready.wait()
        felt = [list(own.probe(center).force) for center in path(200)]
        assert bone.copy().digest() == bone.digest() == digest
        np.testing.assert_array_equal(bone.density, density)
        np.testing.assert_array_equal(
            bone.read((3, 4, 5), (40, 50, 60), pristine=True), pristine[3:43, 4:54, 5:65]
        )
        return felt

    expected = [list(contact.probe(center).force) for center in path(200)]
    with ThreadPoolExecutor(WORKERS) as pool:
        for felt in pool.map(feel, range(WORKERS)):
            assert felt == expected
    assert np.any(expected)
    assert contact.tick == 40


ALONE = "bone must be used by one thread alone while it is changed: another thread "
HERE, BRICK = (3, 3, 4), np.zeros(1, np.uint32)
USES: dict[str, Callable[[VoxelBone, BurrContact], object]] = {
    "step": lambda b, c: c.step(HERE, 1.0, burr_on=False),
    "erode": lambda b, c: c.erode(HERE, 1.0),
    "run": lambda b, c: c.run(path(3), 1.0),
    "hold": lambda b, c: c.hold(0.5, HERE, (0, 0, -1), from_=-4, travel=1, dt=1, ticks=3),
    "probe": lambda b, c: c.probe(HERE),
    "write": lambda b, c: b.write(np.zeros((2, 2, 2), np.uint8)),
    "restore": lambda b, c: b.restore(np.zeros(b.shape, np.uint8)),
    "reset": lambda b, c: b.reset(),
    "density": lambda b, c: b.density,
    "digest": lambda b, c: b.digest(),
    "session": lambda b, c: Session(b, (c.burr, c.material), MailboxDevice()),
    "bricks": lambda b, c: _core.restore_bricks(b, BRICK, np.zeros((1, 512), np.uint8)),
    "loop": lambda b, c: waiting_loop(b, c).start(),
}


def waiting_loop(bone: VoxelBone, contact: BurrContact) -> _core.HapticLoop:
    return _core.HapticLoop(
        _core.TickExecutor(bone, [(contact.burr, contact.material)], 1), [MailboxDevice()], realtime=False
    )


@pytest.mark.parametrize("use", USES)
def test_other_uses_of_a_bone_are_refused_until_its_loop_ends(use: str, contact: BurrContact) -> None:
    bone = contact.bone
    loop = waiting_loop(bone, contact)
    loop.start()
    with pytest.raises(ValueError, match=ALONE + "changes it"):
        USES[use](bone, contact)
    assert (bone.removed, contact.tick) == (0.0, 0)
    loop.stop()
    USES[use](bone, contact)


@pytest.mark.parametrize("lock", [None, threading.Lock()])
@pytest.mark.parametrize("contacts", [1, WORKERS])
def test_threads_on_one_bone_keep_its_sums_right(
    contacts: int, lock: threading.Lock | None, fresh: VoxelBone
) -> None:
    """Without the user's lock some ticks may be refused; these change nothing."""
    bone = fresh.copy()
    shared = [contact_on(bone, worker) for worker in range(contacts)]
    ready, refused = threading.Barrier(WORKERS), []

    def work(worker: int) -> None:
        ready.wait()
        for center in path(200):
            try:
                with lock or contextlib.nullcontext():
                    shared[worker % contacts].step(center, 1.0)
            except ValueError as error:
                refused.append(str(error))

    with ThreadPoolExecutor(WORKERS) as pool:
        list(pool.map(work, range(WORKERS)))
    assert bone.removed == pytest.approx(
        (bone.pristine - bone.density).sum(dtype=int) / 255 * np.prod(bone.spacing), rel=1e-12
    )
    assert sum(contact.tick for contact in shared) + len(refused) == 200 * WORKERS
    assert set(refused) <= (set() if lock else {ALONE + "changes it"})
